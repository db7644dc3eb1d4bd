within ;
package Thermostat "A room whose heater a thermostat switches"

  model Room "Air and walls, a heater that is on or off, weather outside"
    parameter Real C(unit="J/K", min=0) = 9e5 "Heat capacity of the air and the furniture";
    parameter Real CWall(unit="J/K", min=0) = 8e6 "Heat capacity of the walls";
    parameter Real G(unit="W/K", min=0) = 20 "Thermal conductance between air and outside: window and leaks";
    parameter Real GWall(unit="W/K", min=0) = 90 "Thermal conductance between air and walls";
    parameter Real GOut(unit="W/K", min=0) = 25 "Thermal conductance between walls and outside";
    parameter Real PHeat(unit="W", min=0) = 2500 "Power of the heater while it is on";
    parameter Real TSet(unit="K") = 294.15 "Set temperature";
    parameter Real band(unit="K", min=0) = 1.5 "Width of the band between switching on and switching off";
    parameter Real TStart(unit="K") = 294.15 "Temperature of the air at the start";
    parameter Real TWallStart(unit="K") = 290.15 "Temperature of the walls at the start";
    input Real TOut(unit="K", start=275) "Temperature outside";
    Real T(unit="K", start=TStart, fixed=true) "Temperature of the air";
    Real TWall(unit="K", start=TWallStart, fixed=true) "Temperature of the walls";
    Real E(unit="J", start=0, fixed=true) "Energy that the heater has taken";
    discrete Real on(unit="1", start=1, fixed=true) "1 while the heater is on, else 0";
    output Real TAir(unit="K") "Temperature of the air";
    output Real energy(unit="J") "Reading of the heater's energy meter";
  equation
    C*der(T) = on*PHeat + G*(TOut - T) + GWall*(TWall - T);
    CWall*der(TWall) = GWall*(T - TWall) + GOut*(TOut - TWall);
    der(E) = on*PHeat;
    TAir = T;
    energy = E;
    when T < TSet - band/2 then
      on = 1;
    elsewhen T > TSet + band/2 then
      on = 0;
    end when;
  end Room;

end Thermostat;
