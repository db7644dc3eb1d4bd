within ;
package HeatingCircuit "A room whose radiator is fed from a tank; burner and pump switch with a hysteresis each"

  model Room "Tank, radiator, air, walls and the sensor of the room's thermostat"
    parameter Real CTank(unit="J/K") = 4e5 "Heat capacity of the tank";
    parameter Real CRad(unit="J/K") = 8e4 "Heat capacity of the radiator";
    parameter Real C(unit="J/K") = 1e6 "Heat capacity of the air and the furniture";
    parameter Real CWall(unit="J/K") = 8e6 "Heat capacity of the walls";
    parameter Real GFlow(unit="W/K") = 250 "Capacity flow of the water while the pump is on";
    parameter Real GRad(unit="W/K") = 90 "Thermal conductance between radiator and air";
    parameter Real G(unit="W/K") = 25 "Thermal conductance between air and outside";
    parameter Real GWall(unit="W/K") = 90 "Thermal conductance between air and walls";
    parameter Real GOut(unit="W/K") = 25 "Thermal conductance between walls and outside";
    parameter Real PBurner(unit="W") = 6000 "Power of the burner while it is on";
    parameter Real bandTank(unit="K") = 8 "Width of the tank's band between on and off";
    parameter Real band(unit="K") = 0.8 "Width of the room's band between on and off";
    parameter Real lag(unit="s") = 300 "Time constant of the thermostat's sensor";
    input Real TOut(unit="K", start=275) "Temperature outside";
    Real TTank(unit="K", start=328.15, fixed=true) "Temperature of the tank";
    Real TRad(unit="K", start=303.15, fixed=true) "Temperature of the radiator";
    Real T(unit="K", start=294.15, fixed=true) "Temperature of the air";
    Real TWall(unit="K", start=290.15, fixed=true) "Temperature of the walls";
    Real TSensor(unit="K", start=294.15, fixed=true) "Temperature of the thermostat's sensor";
    discrete Real burner(unit="1", start=1, fixed=true) "1 while the burner is on, else 0";
    discrete Real pump(unit="1", start=1, fixed=true) "1 while the pump is on, else 0";
    output Real TAir(unit="K") "Temperature of the air";
    output Real TWater(unit="K") "Temperature of the tank";
    output Real power(unit="W") "Power of the burner";
  equation
    CTank*der(TTank) = burner*PBurner - pump*GFlow*(TTank - TRad);
    CRad*der(TRad) = pump*GFlow*(TTank - TRad) - GRad*(TRad - T);
    C*der(T) = GRad*(TRad - T) + G*(TOut - T) + GWall*(TWall - T);
    CWall*der(TWall) = GWall*(T - TWall) + GOut*(TOut - TWall);
    lag*der(TSensor) = T - TSensor;
    TAir = T;
    TWater = TTank;
    power = burner*PBurner;
    when TTank < 328.15 - bandTank/2 then
      burner = 1;
    elsewhen TTank > 328.15 + bandTank/2 then
      burner = 0;
    end when;
    when TSensor < 294.15 - band/2 then
      pump = 1;
    elsewhen TSensor > 294.15 + band/2 then
      pump = 0;
    end when;
  end Room;

end HeatingCircuit;
