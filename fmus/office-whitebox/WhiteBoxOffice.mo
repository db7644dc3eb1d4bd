within ;
package WhiteBoxOffice "A single office in more detail than a grey box can identify"

  connector HeatPort "Point where heat enters a component"
    Real T(unit="K") "Temperature";
    flow Real Q_flow(unit="W") "Heat flow rate into the component";
  end HeatPort;

  connector RadiantPort "Terminal of the long-wave radiation star"
    Real E(unit="W/m2") "Black-body emissive power";
    flow Real Q_flow(unit="W") "Net long-wave radiation into the component";
  end RadiantPort;

  model Mass "Isothermal mass"
    parameter Real C(unit="J/K", min=0) = 1e5 "Heat capacity";
    parameter Real TStart(unit="K", min=0) = 295.15 "Temperature at the start";
    Real T(unit="K", start=TStart, fixed=true) "Temperature";
    HeatPort port "Surface of the mass";
  equation
    port.T = T;
    C*der(T) = port.Q_flow;
  end Mass;

  model Conduction "Steady conduction between two masses"
    parameter Real G(unit="W/K", min=0) = 1 "Thermal conductance";
    HeatPort a "One side";
    HeatPort b "Other side";
  equation
    a.Q_flow = G*(a.T - b.T);
    b.Q_flow = -G*(a.T - b.T);
  end Conduction;

  model RoomConvection "Natural convection with different coefficients for warm and cold surfaces"
    parameter Real A(unit="m2", min=0) = 1 "Surface area";
    parameter Real kWarm(unit="W/(m2.K)", min=0) = 1.31 "Coefficient at 1 K while the surface is warmer than the air";
    parameter Real kCold(unit="W/(m2.K)", min=0) = 1.31 "Coefficient at 1 K while the surface is colder than the air";
    parameter Real hMix(unit="W/(m2.K)", min=0) = 0.6 "Coefficient that room air currents keep up";
    parameter Real dTSmooth(unit="K", min=0) = 0.3 "Difference below which the cube-root law is rounded off";
    HeatPort surface "Surface";
    HeatPort air "Room air";
  equation
    surface.Q_flow = A*(surface.T - air.T)*(hMix + 0.5*((kWarm + kCold) + (kWarm - kCold)*(surface.T - air.T)
      /sqrt((surface.T - air.T)^2 + dTSmooth^2))*((surface.T - air.T)^2 + dTSmooth^2)^(1/6));
    air.Q_flow = -surface.Q_flow;
  end RoomConvection;

  model RoomRadiation "Long-wave exchange of one surface with the radiant star of the room"
    parameter Real A(unit="m2", min=0) = 1 "Surface area";
    parameter Real epsilon(unit="1", min=0) = 0.9 "Emissivity";
    parameter Real share(unit="1", min=0) = 0.1 "Share of the surface in the whole enclosure";
    HeatPort surface "Surface";
    RadiantPort star "Radiant star";
  equation
    surface.Q_flow = A/((1 - epsilon)/epsilon + 1 - share)*(5.670374e-8*surface.T^4 - star.E);
    star.Q_flow = -surface.Q_flow;
  end RoomRadiation;

  model OutdoorSurface "Wind-driven convection, long-wave exchange with sky and surroundings, absorbed sun"
    parameter Real A(unit="m2", min=0) = 1 "Surface area";
    parameter Real epsilon(unit="1", min=0) = 0.9 "Long-wave emissivity";
    parameter Real alpha(unit="1", min=0) = 0.5 "Short-wave absorptance";
    parameter Real FSky(unit="1", min=0) = 0.5 "View factor to the sky";
    parameter Real hCalm(unit="W/(m2.K)", min=0) = 5.0 "Convective coefficient in calm air";
    parameter Real hWind(unit="J/(m3.K)", min=0) = 3.0 "Increase of the coefficient with wind speed";
    input Real TAmb(unit="K") "Outdoor air temperature";
    input Real TSky(unit="K") "Effective sky temperature";
    input Real vWind(unit="m/s") "Wind speed";
    input Real I(unit="W/m2") "Short-wave irradiance on the surface";
    HeatPort surface "Surface";
  equation
    surface.Q_flow = A*((hCalm + hWind*vWind)*(surface.T - TAmb) - alpha*I
      + epsilon*5.670374e-8*(surface.T^4 - FSky*TSky^4 - (1 - FSky)*TAmb^4));
  end OutdoorSurface;

  model Infiltration "Air exchange through leaks and an opened window, driven by wind and stack effect"
    parameter Real ALeak(unit="m2", min=0) = 1.0e-3 "Effective leakage area";
    parameter Real fStack(unit="m2/(s2.K)", min=0) = 0.0145 "Stack coefficient (squared velocity per kelvin)";
    parameter Real fWind(unit="1", min=0) = 0.0104 "Wind coefficient (squared velocity per squared wind speed)";
    input Real AOpen(unit="m2") "Effective area of an opened window";
    input Real TAmb(unit="K") "Outdoor air temperature";
    input Real vWind(unit="m/s") "Wind speed";
    HeatPort air "Room air";
  equation
    air.Q_flow = 1.23*1008*(ALeak + AOpen)*sqrt(fStack*sqrt((air.T - TAmb)^2 + 0.01) + fWind*vWind^2)*(air.T - TAmb);
  end Infiltration;

  model Exchange "Exchange with a supply flow while it runs"
    parameter Real G(unit="W/K", min=0) = 1 "Conductance at full flow";
    input Real TSup(unit="K") "Supply temperature";
    input Real y(unit="1") "Flow relative to full flow";
    HeatPort port "Exchanging mass";
  equation
    port.Q_flow = y*G*(port.T - TSup);
  end Exchange;

  model Gain "Heat given to a mass"
    input Real Q(unit="W") "Heat flow rate";
    HeatPort port "Receiving mass";
  equation
    port.Q_flow = -Q;
  end Gain;

  model RadiantGain "Heat given to the radiant star"
    input Real Q(unit="W") "Heat flow rate";
    RadiantPort star "Radiant star";
  equation
    star.Q_flow = -Q;
  end RadiantGain;

  model Office "Office with one facade between like offices beside, above and below"
    parameter Real AFloor(unit="m2", min=0) = 12.72 "Floor and ceiling area";
    parameter Real AWall(unit="m2", min=0) = 4.888 "Opaque facade area";
    parameter Real AWindow(unit="m2", min=0) = 2.626 "Glazed area";
    parameter Real APartition(unit="m2", min=0) = 27.0 "Area of the light partitions";
    parameter Real ACorridor(unit="m2", min=0) = 8.0 "Area of the wall to the corridor";
    parameter Real AFurniture(unit="m2", min=0) = 14.0 "Exchanging area of the furniture";
    parameter Real VRoom(unit="m3", min=0) = 36.76 "Air volume";
    parameter Real VSupply(unit="m3/s", min=0) = 0.0150 "Ventilation flow";
    parameter Real GPipe(unit="W/K", min=0) = 110.0 "Pipe to slab core at full flow";
    parameter Real gGlass(unit="1", min=0) = 0.50 "Total solar transmittance of the glazing, normal incidence";
    parameter Real fBlind(unit="1", min=0) = 0.06 "Share of the sun that the lowered blinds let through";
    parameter Real QPerson(unit="W", min=0) = 70.0 "Sensible heat of one person";

    parameter Real TRoomStart(unit="K", min=0) = 296.15 "Room-side temperatures at the start";
    parameter Real TFacadeStart(unit="K", min=0) = 275.15 "Facade skin temperature at the start";

    input Real TAmb(unit="K", start=273.15) "Outdoor air temperature";
    input Real TSky(unit="K", start=260.0) "Effective sky temperature";
    input Real vWind(unit="m/s", start=3.0) "Wind speed";
    input Real IBeam(unit="W/m2", start=0) "Beam irradiance on the facade";
    input Real IDiffuse(unit="W/m2", start=0) "Sky-diffuse and ground-reflected irradiance on the facade";
    input Real cosIncidence(unit="1", start=0) "Cosine of the angle of incidence on the facade, at least 0";
    input Real TSupTAC(unit="K", start=300.15) "Supply temperature of the thermoactive ceiling";
    input Real ySupTAC(unit="1", start=0) "Flow in the thermoactive ceiling, relative";
    input Real TSupMV(unit="K", start=294.15) "Supply temperature of the ventilation";
    input Real ySupMV(unit="1", start=0) "Ventilation flow, relative";
    input Real nPeople(unit="1", start=0) "People in the room";
    input Real QEquipment(unit="W", start=0) "Heat of computers and screens";
    input Real QLight(unit="W", start=0) "Heat of the lighting";
    input Real AOpen(unit="m2", start=0) "Effective area of an opened window";

    output Real TSensor(unit="K") "Temperature of the room sensor";
    output Real TAir(unit="K") "Room air temperature";
    output Real TCore(unit="K") "Slab temperature at the pipes";
    output Real EStar(unit="W/m2") "Black-body emissive power of the radiant star";

    Mass air(C=1.23*1008*VRoom + 2.0e4, TStart=TRoomStart) "Room air, with paper and textiles";
    Mass furniture(C=6.0e4, TStart=TRoomStart) "Furniture, outer layer";
    Mass furnitureCore(C=6.0e4, TStart=TRoomStart) "Furniture, inside";
    Mass partition(C=APartition*8.0e3, TStart=TRoomStart) "Gypsum board facing the room";
    Mass partitionCore(C=APartition*9.0e3, TStart=TRoomStart) "Inner gypsum board up to the middle of the partition";
    Mass corridor(C=ACorridor*1.1e4, TStart=TRoomStart) "Corridor wall facing the room";
    Mass corridorCore(C=ACorridor*2.2e4, TStart=TRoomStart) "Corridor wall up to its middle";
    Mass wallInside(C=AWall*1.9e4, TStart=TRoomStart) "Gypsum boards of the facade panel";
    Mass insulationInside(C=AWall*1.4e3, TStart=0.67*TRoomStart + 0.33*TFacadeStart) "Insulation, inner half";
    Mass insulationOutside(C=AWall*1.4e3, TStart=0.33*TRoomStart + 0.67*TFacadeStart) "Insulation, outer half";
    Mass cladding(C=AWall*2.5e4, TStart=TFacadeStart) "Facade panel's thin concrete shell";
    Mass paneInside(C=AWindow*1.1e4, TStart=0.8*TRoomStart + 0.2*TFacadeStart) "Inner glass pane";
    Mass paneOutside(C=AWindow*1.1e4, TStart=TFacadeStart) "Outer glass pane";
    Mass ceiling(C=AFloor*2.9e4, TStart=TRoomStart) "Slab: lowest 13 mm, facing the room";
    Mass slabLow(C=AFloor*1.05e5, TStart=TRoomStart + 1) "Slab: between ceiling and pipes";
    Mass core(C=AFloor*1.1e5, TStart=TRoomStart + 2) "Slab: concrete around the pipes";
    Mass slabHigh(C=AFloor*1.6e5, TStart=TRoomStart + 1) "Slab: above the pipes";
    Mass deck(C=AFloor*5.5e4, TStart=TRoomStart) "Panels of the raised floor";
    Mass floor(C=AFloor*1.2e4, TStart=TRoomStart) "Floor covering, facing the room above";
    Mass sensor(C=60.0, TStart=TRoomStart) "Room sensor with its housing on the wall";

    Conduction furnitureLayers(G=45.0) "Inside the furniture";
    Conduction partitionLayers(G=APartition*12.0) "Between the gypsum boards";
    Conduction corridorLayers(G=ACorridor*14.0) "Inside the corridor wall";
    Conduction wallInsulation1(G=AWall*2.0) "Gypsum to insulation";
    Conduction wallInsulation2(G=AWall*1.0) "Middle of the insulation";
    Conduction wallInsulation3(G=AWall*2.0) "Insulation to cladding";
    Conduction glazingGap(G=AWindow*0.8) "Gas between the panes";
    Conduction slab1(G=AFloor*40.0) "Ceiling surface to slab";
    Conduction slab2(G=AFloor*30.0) "Slab to pipe level";
    Conduction slab3(G=AFloor*18.0) "Pipe level to upper slab";
    Conduction slab4(G=AFloor*1.2) "Cavity under the raised floor";
    Conduction slab5(G=AFloor*14.0) "Panels to covering";
    Conduction sensorMount(G=0.006) "Sensor to the wall behind it";

    RoomConvection convectionFurniture(A=AFurniture) "Furniture to air";
    RoomConvection convectionPartition(A=APartition) "Partitions to air";
    RoomConvection convectionCorridor(A=ACorridor) "Corridor wall to air";
    RoomConvection convectionWall(A=AWall) "Facade panel to air";
    RoomConvection convectionPane(A=AWindow) "Glass to air";
    RoomConvection convectionCeiling(A=AFloor, kWarm=0.76, kCold=1.52) "Ceiling to air";
    RoomConvection convectionFloor(A=AFloor, kWarm=1.52, kCold=0.76) "Floor to air";
    RoomConvection convectionSensor(A=0.012, hMix=12.0) "Sensor to air";

    RoomRadiation radiationFurniture(A=AFurniture, share=0.17) "Furniture to star";
    RoomRadiation radiationPartition(A=APartition, share=0.33) "Partitions to star";
    RoomRadiation radiationCorridor(A=ACorridor, share=0.10) "Corridor wall to star";
    RoomRadiation radiationWall(A=AWall, share=0.06) "Facade panel to star";
    RoomRadiation radiationPane(A=AWindow, epsilon=0.84, share=0.03) "Glass to star";
    RoomRadiation radiationCeiling(A=AFloor, share=0.155) "Ceiling to star";
    RoomRadiation radiationFloor(A=AFloor, share=0.155) "Floor to star";
    RoomRadiation radiationSensor(A=0.012, share=0.0) "Sensor to star";

    OutdoorSurface outsideWall(A=AWall, alpha=0.6) "Facade panel outdoors";
    OutdoorSurface outsidePane(A=AWindow, alpha=0.10, epsilon=0.84) "Glass outdoors";
    Infiltration leak "Infiltration";
    Exchange ventilation(G=1.23*1008*VSupply) "Mechanical ventilation";
    Exchange pipe(G=GPipe) "Pipe register of the ceiling";

    Gain gainAir "Convective internal gains";
    Gain sunFloor "Sun on the floor";
    Gain sunFurniture "Sun on the furniture";
    Gain sunPartition "Sun on the partitions";
    Gain sunAir "Sun that the blinds give to the air";
    RadiantGain gainStar "Radiative internal gains";
    Real QSun(unit="W") "Sun let into the room";
  equation
    QSun = gGlass*fBlind*AWindow*(IBeam*(1 - (1 - cosIncidence)^5) + 0.88*IDiffuse);
    sunAir.Q = 0.15*QSun;
    sunFloor.Q = 0.40*QSun;
    sunFurniture.Q = 0.30*QSun;
    sunPartition.Q = 0.15*QSun;
    gainAir.Q = 0.5*QPerson*nPeople + 0.7*QEquipment + 0.4*QLight;
    gainStar.Q = 0.5*QPerson*nPeople + 0.3*QEquipment + 0.6*QLight;

    outsideWall.TAmb = TAmb;
    outsideWall.TSky = TSky;
    outsideWall.vWind = vWind;
    outsideWall.I = IBeam + IDiffuse;
    outsidePane.TAmb = TAmb;
    outsidePane.TSky = TSky;
    outsidePane.vWind = vWind;
    outsidePane.I = IBeam + IDiffuse;
    leak.TAmb = TAmb;
    leak.vWind = vWind;
    leak.AOpen = AOpen;
    ventilation.TSup = TSupMV;
    ventilation.y = ySupMV;
    pipe.TSup = TSupTAC;
    pipe.y = ySupTAC;

    connect(furniture.port, furnitureLayers.a);
    connect(furnitureLayers.b, furnitureCore.port);
    connect(partition.port, partitionLayers.a);
    connect(partitionLayers.b, partitionCore.port);
    connect(corridor.port, corridorLayers.a);
    connect(corridorLayers.b, corridorCore.port);
    connect(wallInside.port, wallInsulation1.a);
    connect(wallInsulation1.b, insulationInside.port);
    connect(insulationInside.port, wallInsulation2.a);
    connect(wallInsulation2.b, insulationOutside.port);
    connect(insulationOutside.port, wallInsulation3.a);
    connect(wallInsulation3.b, cladding.port);
    connect(cladding.port, outsideWall.surface);
    connect(paneInside.port, glazingGap.a);
    connect(glazingGap.b, paneOutside.port);
    connect(paneOutside.port, outsidePane.surface);
    connect(ceiling.port, slab1.a);
    connect(slab1.b, slabLow.port);
    connect(slabLow.port, slab2.a);
    connect(slab2.b, core.port);
    connect(core.port, slab3.a);
    connect(slab3.b, slabHigh.port);
    connect(slabHigh.port, slab4.a);
    connect(slab4.b, deck.port);
    connect(deck.port, slab5.a);
    connect(slab5.b, floor.port);
    connect(core.port, pipe.port);
    connect(sensor.port, sensorMount.a);
    connect(sensorMount.b, partition.port);

    connect(furniture.port, convectionFurniture.surface);
    connect(convectionFurniture.air, air.port);
    connect(partition.port, convectionPartition.surface);
    connect(convectionPartition.air, air.port);
    connect(corridor.port, convectionCorridor.surface);
    connect(convectionCorridor.air, air.port);
    connect(wallInside.port, convectionWall.surface);
    connect(convectionWall.air, air.port);
    connect(paneInside.port, convectionPane.surface);
    connect(convectionPane.air, air.port);
    connect(ceiling.port, convectionCeiling.surface);
    connect(convectionCeiling.air, air.port);
    connect(floor.port, convectionFloor.surface);
    connect(convectionFloor.air, air.port);
    connect(sensor.port, convectionSensor.surface);
    connect(convectionSensor.air, air.port);

    connect(furniture.port, radiationFurniture.surface);
    connect(partition.port, radiationPartition.surface);
    connect(corridor.port, radiationCorridor.surface);
    connect(wallInside.port, radiationWall.surface);
    connect(paneInside.port, radiationPane.surface);
    connect(ceiling.port, radiationCeiling.surface);
    connect(floor.port, radiationFloor.surface);
    connect(sensor.port, radiationSensor.surface);
    connect(gainStar.star, radiationFurniture.star);
    connect(gainStar.star, radiationPartition.star);
    connect(gainStar.star, radiationCorridor.star);
    connect(gainStar.star, radiationWall.star);
    connect(gainStar.star, radiationPane.star);
    connect(gainStar.star, radiationCeiling.star);
    connect(gainStar.star, radiationFloor.star);
    connect(gainStar.star, radiationSensor.star);

    connect(air.port, leak.air);
    connect(air.port, ventilation.port);
    connect(air.port, gainAir.port);
    connect(air.port, sunAir.port);
    connect(floor.port, sunFloor.port);
    connect(furniture.port, sunFurniture.port);
    connect(partition.port, sunPartition.port);

    TSensor = sensor.T;
    TAir = air.T;
    TCore = core.T;
    EStar = gainStar.star.E;
  end Office;
end WhiteBoxOffice;
