within ;
package TwoRooms "Two rooms with a wall between them"

  model Flat "Rooms of one temperature each, the masonry between them, heaters, sun, and weather outside"
    parameter Real C1(unit="J/K", min=0) = 1e6 "Heat capacity of room 1";
    parameter Real C2(unit="J/K", min=0) = 1e6 "Heat capacity of room 2";
    parameter Real CWall(unit="J/K", min=0) = 4e6 "Heat capacity of the wall between the rooms";
    parameter Real G1(unit="W/K", min=0) = 20 "Conductance between room 1 and outside";
    parameter Real G2(unit="W/K", min=0) = 20 "Conductance between room 2 and outside";
    parameter Real GWall(unit="W/K", min=0) = 50 "Conductance between a room and the middle of the wall";
    parameter Real A1(unit="m2", min=0) = 1 "Effective window area of room 1";
    parameter Real A2(unit="m2", min=0) = 1 "Effective window area of room 2";
    parameter Real GDoor(unit="W/K", min=0) = 0 "Conductance through the door between the rooms; 0 where it is shut";
    parameter Real T1Start(unit="K") = 293.15 "Temperature of room 1 at the start";
    parameter Real T2Start(unit="K") = 293.15 "Temperature of room 2 at the start";
    parameter Real TWallStart(unit="K") = 293.15 "Temperature of the wall at the start";
    input Real TOut(unit="K", start=278.15) "Temperature outside";
    input Real sun(unit="W/m2", start=0) "Radiation on the windows";
    input Real q1(unit="W", start=0) "Heat flow of the heater in room 1";
    input Real q2(unit="W", start=0) "Heat flow of the heater in room 2";
    Real T1(unit="K", start=T1Start, fixed=true) "Temperature of room 1";
    Real T2(unit="K", start=T2Start, fixed=true) "Temperature of room 2";
    Real TWall(unit="K", start=TWallStart, fixed=true) "Temperature of the wall";
    output Real TRoom1(unit="K") "Temperature of room 1";
    output Real TRoom2(unit="K") "Temperature of room 2";
  equation
    C1*der(T1) = q1 + A1*sun + G1*(TOut - T1) + GWall*(TWall - T1) + GDoor*(T2 - T1);
    C2*der(T2) = q2 + A2*sun + G2*(TOut - T2) + GWall*(TWall - T2) + GDoor*(T1 - T2);
    CWall*der(TWall) = GWall*(T1 - TWall) + GWall*(T2 - TWall);
    TRoom1 = T1;
    TRoom2 = T2;
  end Flat;

end TwoRooms;
