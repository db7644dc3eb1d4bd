within ;
package Slab "Heat through a floor slab between two rooms that are used alike"

  model EmbeddedSensor "Three temperatures over the slab's thickness and a sensor somewhere between them"
    parameter Real GBelow(unit="W/K", min=0) = 100 "Conductance between the room below and the slab";
    parameter Real GAbove(unit="W/K", min=0) = 100 "Conductance between the slab and the room above";
    parameter Real GSlab(unit="W/K", min=0) = 90 "Conductance through the whole slab";
    parameter Real C(unit="J/K", min=0) = 6e6 "Heat capacity of the whole slab";
    parameter Real depth(unit="1") = 0.5 "Place of the sensor: 0 is the ceiling below, 1 the floor above";
    parameter Real TStart(unit="K") = 292.15 "Temperature of the slab at the start";
    input Real TBelow(unit="K", start=293.15) "Temperature of the room below";
    input Real TAbove(unit="K", start=293.15) "Temperature of the room above";
    Real T1(unit="K", start=TStart, fixed=true) "Temperature of the lower side";
    Real T2(unit="K", start=TStart, fixed=true) "Temperature of the middle";
    Real T3(unit="K", start=TStart, fixed=true) "Temperature of the upper side";
    output Real TSensor(unit="K") "Temperature at the sensor";
  equation
    C/4*der(T1) = GBelow*(TBelow - T1) - 2*GSlab*(T1 - T2);
    C/2*der(T2) = 2*GSlab*(T1 - T2) - 2*GSlab*(T2 - T3);
    C/4*der(T3) = 2*GSlab*(T2 - T3) - GAbove*(T3 - TAbove);
    TSensor = (1 - depth)*(1 - 2*depth)*T1 + 4*depth*(1 - depth)*T2 + depth*(2*depth - 1)*T3;
  end EmbeddedSensor;

end Slab;
