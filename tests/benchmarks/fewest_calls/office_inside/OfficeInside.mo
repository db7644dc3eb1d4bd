within ;
package OfficeInside "The grey-box office with its weather, schedules and gains inside the model"

  model Room "7 resistances and 4 capacities as in fmus/office; nothing is an input"
    constant Real areaWall = 4.888 "Area of the external wall [m2]";
    constant Real areaWindow = 2.626 "Area of the window [m2]";
    constant Real areaInternal = 36.1589 "Surface of the internal masses [m2]";
    constant Real areaFloor = 12.72 "Floor area [m2]";
    constant Real areaCeiling = 11.935 "Area of the thermoactive ceiling [m2]";
    constant Real capacityRoom = 45578.7 "Heat capacity of the room air [J/K]";
    constant Real capacitySupply = 1204.8 "Heat capacity of the supply air by volume [J/(m3.K)]";
    constant Real perDay = 7.27220521664304e-5 "Angular frequency of a day [rad/s]";

    parameter Real cExt1(unit="J/(m2.K)") = 8500 "Heat capacity of the external wall by area";
    parameter Real b(unit="1") = 5 "Multiple of the heat capacity of the room air";
    parameter Real cInt(unit="J/(m2.K)") = 182e3 "Heat capacity of the internal masses by floor area";
    parameter Real cTABS(unit="J/(m2.K)") = 7e5 "Heat capacity of the thermoactive ceiling by area";
    parameter Real rZone(unit="m2.K/W") = 0.183 "Resistance between the thermoactive ceiling and the zone";
    parameter Real rPipe(unit="m2.K/W") = 0.122 "Resistance between the water and the thermoactive ceiling";
    parameter Real rExt1(unit="m2.K/W") = 1.06 "Resistance of the external wall, inner part";
    parameter Real rExt2(unit="m2.K/W") = 0.05 "Resistance of the external wall, outer part";
    parameter Real UWin(unit="W/(m2.K)") = 0.7 "Thermal transmittance of the window";
    parameter Real VSUP(unit="m3/s") = 0.0111 "Supply air flow rate while the ventilation is on";
    parameter Real rInt(unit="m2.K/W") = 0.18 "Resistance between the internal masses and the air";
    parameter Real fSol(unit="m2") = 0.1 "Effective area that collects the solar radiation";
    parameter Real qIntOcc(unit="W/m2") = 12 "Internal gain at full occupancy by floor area";
    parameter Real TTABSInit(unit="K") = 301.15 "Temperature of the thermoactive ceiling at the start";

    Real TRoom(unit="K", start=296.15, fixed=true) "Temperature of the air";
    Real TMasses(unit="K", start=296.15, fixed=true) "Temperature of the internal masses";
    Real TWall(unit="K", start=280, fixed=true) "Temperature of the external wall";
    Real TCeiling(unit="K", start=TTABSInit, fixed=true) "Temperature of the thermoactive ceiling";

    output Real TAir(unit="K") "Air temperature of the room";
    // What tools show beside it: weather, use, what follows from them, and what follows from the states.
    output Real TAmb(unit="K") "Outdoor air temperature";
    output Real TAmbDegC(unit="degC") "The same in degC";
    output Real TAmbEq(unit="K") "Equivalent outdoor temperature of the external wall";
    output Real HGlo(unit="W/m2") "Global horizontal radiation";
    output Real HGloShare(unit="1") "The same as a share of 1000 W/m2";
    output Real occ(unit="1") "Occupancy, 8 to 18 o'clock";
    output Real TSupTAC(unit="K") "Supply water temperature of the thermoactive ceiling";
    output Real yTAC(unit="1") "Whether its water circuit is on, 22 to 6 o'clock";
    output Real TSupMV(unit="K") "Supply air temperature of the ventilation";
    output Real yMV(unit="1") "Whether the ventilation is on, 7 to 19 o'clock";
    output Real clock(unit="1") "Sine of the time of day";
    output Real albedo(unit="1") "A constant";
    output Real QSol(unit="W") "Solar gain";
    output Real QOcc(unit="W") "Gain from occupants and devices";
    output Real QCeiling(unit="W") "Heat flow from the ceiling";
    output Real QWindow(unit="W") "Heat flow through the window";
  equation
    TAmb = 276 + 3*sin(perDay*time/5.3) + 4*cos(perDay*time - 3.9) + 1.2*sin(perDay*time/1.37 + 0.4);
    TAmbDegC = TAmb - 273.15;
    HGlo = 500*max(0, -cos(perDay*time) - 0.2)*(0.65 + 0.35*sin(perDay*time/2.7));
    HGloShare = HGlo/1000;
    TAmbEq = TAmb + 0.02*HGlo;
    occ = if cos(perDay*(time + 1) - 3.403392041388943) > 0.25881904510252 then 1 else 0;
    yTAC = if cos(perDay*(time + 1) - 0.523598775598299) > 0.5 then 1 else 0;
    yMV = if -cos(perDay*(time + 1) - 0.261799387799149) > 0 then 1 else 0;
    TSupTAC = 302 - 0.4*(TAmb - 276) + 0.8*sin(perDay*time/3.1);
    TSupMV = 293 + 0.5*cos(perDay*time/1.9);
    clock = sin(perDay*time);
    albedo = 0.2;
    QSol = fSol*HGlo;
    QOcc = qIntOcc*areaFloor*occ;
    QCeiling = areaCeiling/rZone*(TCeiling - 0.8*TMasses - 0.2*TRoom);
    QWindow = UWin*areaWindow*(TAmb - TRoom);
    b*capacityRoom*der(TRoom) = QWindow + areaInternal/rInt*(TMasses - TRoom) + areaWall/rExt1*(TWall - TRoom)
      + yMV*VSUP*capacitySupply*(TSupMV - TRoom) + 0.2*QCeiling + 0.09*QSol + 0.3*QOcc;
    cInt*areaFloor*der(TMasses) = areaInternal/rInt*(TRoom - TMasses) + 0.8*QCeiling + 0.91*QSol + 0.7*QOcc;
    cExt1*areaWall*der(TWall) = areaWall/rExt1*(TRoom - TWall) + areaWall/rExt2*(TAmbEq - TWall);
    cTABS*areaCeiling*der(TCeiling) = yTAC*areaCeiling/rPipe*(TSupTAC - TCeiling) - QCeiling;
    TAir = TRoom;
  end Room;

end OfficeInside;
