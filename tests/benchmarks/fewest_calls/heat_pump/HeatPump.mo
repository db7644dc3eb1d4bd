within ;
package HeatPump "A room whose floor a heat pump warms, with a limited power and a shortest time between switchings"

  model Room "Floor, air and walls, a heat pump that is on or off"
    parameter Real CFloor(unit="J/K") = 3e6 "Heat capacity of the floor";
    parameter Real C(unit="J/K") = 1e6 "Heat capacity of the air and the furniture";
    parameter Real CWall(unit="J/K") = 8e6 "Heat capacity of the walls";
    parameter Real GFloor(unit="W/K") = 250 "Thermal conductance between floor and air";
    parameter Real G(unit="W/K") = 40 "Thermal conductance between air and outside";
    parameter Real GWall(unit="W/K") = 90 "Thermal conductance between air and walls";
    parameter Real GOut(unit="W/K") = 25 "Thermal conductance between walls and outside";
    parameter Real PLimit(unit="W") = 4000 "Heating power at 0 degC outside";
    parameter Real slope(unit="W/K") = 100 "Rise of the heating power with the temperature outside";
    parameter Real band(unit="K") = 0.4 "Width of the band between on and off";
    parameter Real tLeast(unit="s") = 1800 "Shortest time between two switchings";
    input Real TOut(unit="K", start=275) "Temperature outside";
    Real TFloor(unit="K", start=296.15, fixed=true) "Temperature of the floor";
    Real T(unit="K", start=294.15, fixed=true) "Temperature of the air";
    Real TWall(unit="K", start=290.15, fixed=true) "Temperature of the walls";
    Real E(unit="J", start=0, fixed=true) "Heat that the floor has taken";
    discrete Real on(unit="1", start=1, fixed=true) "1 while the heat pump is on, else 0";
    discrete Real tLast(unit="s", start=0, fixed=true) "Time of the last switching";
    output Real TAir(unit="K") "Temperature of the air";
    output Real heat(unit="J") "Reading of the heat meter";
  equation
    CFloor*der(TFloor) = on*(PLimit + slope*(TOut - 273.15)) - GFloor*(TFloor - T);
    C*der(T) = GFloor*(TFloor - T) + G*(TOut - T) + GWall*(TWall - T);
    CWall*der(TWall) = GWall*(T - TWall) + GOut*(TOut - TWall);
    der(E) = on*(PLimit + slope*(TOut - 273.15));
    TAir = T;
    heat = E;
    when T < 294.15 - band/2 and pre(on) < 0.5 and time > pre(tLast) + tLeast then
      on = 1;
      tLast = time;
    elsewhen T > 294.15 + band/2 and pre(on) > 0.5 and time > pre(tLast) + tLeast then
      on = 0;
      tLast = time;
    end when;
  end Room;

end HeatPump;
