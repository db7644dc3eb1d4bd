within ;
package Office "Small thermal RC library and the grey-box office zone with 7 resistances and 4 capacities"

  type Temperature = Real(unit="K", min=0) "Absolute temperature";
  type HeatFlowRate = Real(unit="W") "Heat flow rate";
  type HeatCapacity = Real(unit="J/K", min=0) "Heat capacity";
  type ThermalConductance = Real(unit="W/K", min=0) "Thermal conductance";

  connector HeatPort "Place where heat is exchanged"
    Temperature T "Temperature at the port";
    flow HeatFlowRate Q_flow "Heat flow rate into the component";
  end HeatPort;

  model HeatCapacitor "Body of one temperature"
    parameter HeatCapacity C "Heat capacity";
    parameter Temperature TStart "Temperature at the start";
    Real T(unit="K", min=0, start=TStart, fixed=true) "Temperature of the body";
    HeatPort port "Surface of the body";
  equation
    T = port.T;
    C*der(T) = port.Q_flow;
  end HeatCapacitor;

  partial model TwoPorts "Heat flow between two ports, nothing stored"
    HeatPort a "First port";
    HeatPort b "Second port";
    HeatFlowRate Q_flow "Heat flow rate from a to b";
  equation
    a.Q_flow = Q_flow;
    b.Q_flow = -Q_flow;
  end TwoPorts;

  model Conductor "Constant thermal conductance"
    extends TwoPorts;
    parameter ThermalConductance G "Conductance";
  equation
    Q_flow = G*(a.T - b.T);
  end Conductor;

  model SwitchedConductor "Conductance of a flow circuit that is on while its signal exceeds a threshold"
    extends TwoPorts;
    constant Real threshold(unit="1") = 0.1 "Signal above which the circuit is on";
    constant ThermalConductance GOff = 1e-6 "Conductance while off";
    parameter ThermalConductance GOn "Conductance while on";
    input Real signal(unit="1") "Signal of the circuit";
  equation
    Q_flow = (if signal > threshold then GOn else GOff)*(a.T - b.T);
  end SwitchedConductor;

  model SharedPort "Port at the weighted mean of two temperatures that takes the heat flow in the same shares"
    parameter Real share(unit="1", min=0, max=1) "Share of the first body";
    HeatPort first "First body";
    HeatPort second "Second body";
    HeatPort mean "Port at the weighted mean temperature";
  equation
    mean.T = share*first.T + (1 - share)*second.T;
    first.Q_flow = -share*mean.Q_flow;
    second.Q_flow = -(1 - share)*mean.Q_flow;
  end SharedPort;

  model Surrounding "Given temperature"
    HeatPort port "Port at the given temperature";
    input Temperature T "Given temperature";
  equation
    port.T = T;
  end Surrounding;

  model HeatGain "Given heat flow rate"
    HeatPort port "Port that is heated";
    input HeatFlowRate Q_flow "Heat flow rate out of this component";
  equation
    port.Q_flow = -Q_flow;
  end HeatGain;

  model R7C4Office "Office with external wall, window, internal masses, thermoactive ceiling and ventilation"
    constant Real areaWall(unit="m2") = 4.888 "Area of the external wall";
    constant Real areaWindow(unit="m2") = 2.626 "Area of the window";
    constant Real areaInternal(unit="m2") = 36.1589 "Surface of the internal masses";
    constant Real areaFloor(unit="m2") = 12.72 "Floor area";
    constant Real areaCeiling(unit="m2") = 11.935 "Area of the thermoactive ceiling";
    constant Real volumeAir(unit="m3") = 36.7608 "Volume of the room air";
    constant Real capacityAir(unit="J/(m3.K)") = 1.23*1008 "Capacity of the room air by volume";
    constant Real capacitySupply(unit="J/(m3.K)") = 1204.8 "Capacity of the supply air by volume";
    constant Real solarToAir(unit="1") = 0.09 "Share of the solar gain that heats the air";
    constant Real occupantsToAir(unit="1") = 0.3 "Share of the occupants' gain that heats the air";
    constant Real ceilingToMasses(unit="1") = 0.8 "Share of the ceiling's exchange with the internal masses";

    parameter Real cExt1(unit="J/(m2.K)", min=1700, max=42500) = 8500 "Heat capacity of the external wall by area";
    parameter Real b(unit="1", min=1, max=25) = 5 "Multiple of the heat capacity of the room air";
    parameter Real cInt(unit="J/(m2.K)", min=1e5, max=4.5e5) = 182e3
      "Heat capacity of the internal masses by floor area";
    parameter Real cTABS(unit="J/(m2.K)", min=1.4e5, max=3.5e6) = 7e5
      "Heat capacity of the thermoactive ceiling by area";
    parameter Real rZone(unit="m2.K/W", min=0.0366, max=0.915) = 0.183
      "Thermal resistance between the thermoactive ceiling and the zone";
    parameter Real rPipe(unit="m2.K/W", min=0.0244, max=0.61) = 0.122
      "Thermal resistance between the water and the thermoactive ceiling";
    parameter Real rExt1(unit="m2.K/W", min=0.212, max=5.3) = 1.06
      "Thermal resistance of the external wall, inner part";
    parameter Real rExt2(unit="m2.K/W", min=0.01, max=0.25) = 0.05
      "Thermal resistance of the external wall, outer part";
    parameter Real UWin(unit="W/(m2.K)", min=0.14, max=3.5) = 0.7 "Thermal transmittance of the window";
    parameter Real VSUP(unit="m3/s", min=0.00222, max=0.0555) = 0.0111 "Supply air flow rate while the ventilation is on";
    parameter Real rInt(unit="m2.K/W", min=0.036, max=0.9) = 0.18
      "Thermal resistance between the internal masses and the air";
    parameter Real fSol(unit="m2", min=0.02, max=0.5) = 0.1 "Effective area that collects the solar radiation";
    parameter Real qIntOcc(unit="W/m2", min=2.4, max=60) = 12 "Internal gain at full occupancy by floor area";
    parameter Real TTABSInit(unit="K", min=293.15, max=306.15) = 301.15
      "Temperature of the thermoactive ceiling at the start";
    parameter Real TAirInit(unit="K", min=0) = 296.15 "Temperature of the air and the internal masses at the start";
    parameter Real TWallInit(unit="K", min=0) = 280 "Temperature of the external wall at the start";

    input Real TAmb(unit="K", min=0, start=273.15) "Outdoor air temperature";
    input Real TAmbEq(unit="K", min=0, start=273.15) "Equivalent outdoor temperature of the external wall";
    input Real TSupTAC(unit="K", min=0, start=296.15) "Supply water temperature of the thermoactive ceiling";
    input Real ySupTAC(unit="1", start=0) "Signal of the water circuit, on above 0.1";
    input Real TSupMV(unit="K", min=0, start=293.15) "Supply air temperature of the ventilation";
    input Real ySupMV(unit="1", start=0) "Signal of the ventilation, on above 0.1";
    input Real HGlo(unit="W/m2", start=0) "Global horizontal radiation";
    input Real occ(unit="1", start=0) "Occupancy between 0 and 1";
    output Real TAir(unit="K", min=0) "Air temperature of the room";

    HeatCapacitor air(C=b*capacityAir*volumeAir, TStart=TAirInit) "Room air";
    HeatCapacitor masses(C=cInt*areaFloor, TStart=TAirInit) "Internal masses";
    HeatCapacitor wall(C=cExt1*areaWall, TStart=TWallInit) "External wall";
    HeatCapacitor ceiling(C=cTABS*areaCeiling, TStart=TTABSInit) "Thermoactive ceiling";
    Conductor window(G=UWin*areaWindow) "Window";
    Conductor massesToAir(G=areaInternal/rInt) "Surface of the internal masses";
    Conductor wallInside(G=areaWall/rExt1) "Inner part of the external wall";
    Conductor wallOutside(G=areaWall/rExt2) "Outer part of the external wall";
    Conductor ceilingToZone(G=areaCeiling/rZone) "Surface of the thermoactive ceiling";
    SwitchedConductor pipe(GOn=areaCeiling/rPipe, signal=ySupTAC) "Water circuit of the thermoactive ceiling";
    SwitchedConductor ventilation(GOn=VSUP*capacitySupply, signal=ySupMV) "Ventilation";
    SharedPort zone(share=ceilingToMasses) "What the thermoactive ceiling sees";
    Surrounding ambient(T=TAmb) "Outdoor air";
    Surrounding ambientWall(T=TAmbEq) "Outdoor air and sun on the external wall";
    Surrounding water(T=TSupTAC) "Supply water";
    Surrounding supplyAir(T=TSupMV) "Supply air";
    HeatGain gainAir(Q_flow=solarToAir*fSol*HGlo + occupantsToAir*qIntOcc*areaFloor*occ) "Gains of the air";
    HeatGain gainMasses(Q_flow=(1 - solarToAir)*fSol*HGlo + (1 - occupantsToAir)*qIntOcc*areaFloor*occ)
      "Gains of the internal masses";
  equation
    TAir = air.T;
    connect(ambient.port, window.a);
    connect(window.b, air.port);
    connect(supplyAir.port, ventilation.a);
    connect(ventilation.b, air.port);
    connect(masses.port, massesToAir.a);
    connect(massesToAir.b, air.port);
    connect(ambientWall.port, wallOutside.a);
    connect(wallOutside.b, wall.port);
    connect(wall.port, wallInside.a);
    connect(wallInside.b, air.port);
    connect(water.port, pipe.a);
    connect(pipe.b, ceiling.port);
    connect(ceiling.port, ceilingToZone.a);
    connect(ceilingToZone.b, zone.mean);
    connect(zone.first, masses.port);
    connect(zone.second, air.port);
    connect(gainAir.port, air.port);
    connect(gainMasses.port, masses.port);
  end R7C4Office;

end Office;
