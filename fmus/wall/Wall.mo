within ;
package Wall "Heat through a wall between a room and the weather"

  model ThreeLayers "Plaster, masonry and facade, each of one temperature; surfaces with heat transfer"
    parameter Real GIn(unit="W/K", min=0) = 75 "Conductance between the room and the plaster";
    parameter Real G12(unit="W/K", min=0) = 20 "Conductance between plaster and masonry";
    parameter Real G23(unit="W/K", min=0) = 10 "Conductance between masonry and facade";
    parameter Real GOut(unit="W/K", min=0) = 200 "Conductance between the facade and the weather";
    parameter Real C1(unit="J/K", min=0) = 2e5 "Heat capacity of the plaster";
    parameter Real C2(unit="J/K", min=0) = 2e6 "Heat capacity of the masonry";
    parameter Real C3(unit="J/K", min=0) = 4e5 "Heat capacity of the facade";
    parameter Real T1Start(unit="K") = 293.15 "Temperature of the plaster at the start";
    parameter Real T2Start(unit="K") = 288.15 "Temperature of the masonry at the start";
    parameter Real T3Start(unit="K") = 278.15 "Temperature of the facade at the start";
    input Real TIn(unit="K", start=293.15) "Temperature of the room";
    input Real TOut(unit="K", start=278.15) "Temperature of the weather";
    Real T1(unit="K", start=T1Start, fixed=true) "Temperature of the plaster";
    Real T2(unit="K", start=T2Start, fixed=true) "Temperature of the masonry";
    Real T3(unit="K", start=T3Start, fixed=true) "Temperature of the facade";
    output Real TMasonry(unit="K") "Temperature in the middle of the wall";
    output Real QRoom(unit="W") "Heat flow from the room into the wall";
  equation
    QRoom = GIn*(TIn - T1);
    C1*der(T1) = QRoom - G12*(T1 - T2);
    C2*der(T2) = G12*(T1 - T2) - G23*(T2 - T3);
    C3*der(T3) = G23*(T2 - T3) - GOut*(T3 - TOut);
    TMasonry = T2;
  end ThreeLayers;

end Wall;
