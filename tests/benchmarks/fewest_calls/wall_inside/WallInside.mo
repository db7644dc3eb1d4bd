within ;
package WallInside "The wall with the room's and the weather's temperatures inside the model"

  model ThreeLayers "Plaster, masonry and facade as in fmus/wall; nothing is an input"
    constant Real perDay = 7.27220521664304e-5 "Angular frequency of a day [rad/s]";
    parameter Real GIn(unit="W/K", min=0) = 75 "Conductance between the room and the plaster";
    parameter Real G12(unit="W/K", min=0) = 20 "Conductance between plaster and masonry";
    parameter Real G23(unit="W/K", min=0) = 10 "Conductance between masonry and facade";
    parameter Real GOut(unit="W/K", min=0) = 200 "Conductance between the facade and the weather";
    parameter Real C1(unit="J/K", min=0) = 2e5 "Heat capacity of the plaster";
    parameter Real C2(unit="J/K", min=0) = 2e6 "Heat capacity of the masonry";
    parameter Real C3(unit="J/K", min=0) = 4e5 "Heat capacity of the facade";
    parameter Real T2Start(unit="K") = 288.15 "Temperature of the masonry at the start";
    Real T1(unit="K", start=293.15, fixed=true) "Temperature of the plaster";
    Real T2(unit="K", start=T2Start, fixed=true) "Temperature of the masonry";
    Real T3(unit="K", start=278.15, fixed=true) "Temperature of the facade";
    output Real TMasonry(unit="K") "Temperature in the middle of the wall";
    output Real QRoom(unit="W") "Heat flow from the room into the wall";
    output Real TIn(unit="K") "Temperature of the room: 21.5 degC from 6:10 to 22:10, else 18 degC";
    output Real TOut(unit="K") "Temperature of the weather";
    output Real QOut(unit="W") "Heat flow from the weather into the wall";
  equation
    TIn = 291.15 + (if cos(perDay*(time + 1) - 3.70882466048796) > -0.5 then 3.5 else 0)
      + 0.3*sin(perDay*time/0.31);
    TOut = 277 + 3*sin(perDay*time/4.3) + 5*cos(perDay*time - 3.9) + 1.2*sin(perDay*time/0.37 + 0.4);
    QRoom = GIn*(TIn - T1);
    QOut = GOut*(TOut - T3);
    C1*der(T1) = QRoom - G12*(T1 - T2);
    C2*der(T2) = G12*(T1 - T2) - G23*(T2 - T3);
    C3*der(T3) = G23*(T2 - T3) + QOut;
    TMasonry = T2;
  end ThreeLayers;

end WallInside;
