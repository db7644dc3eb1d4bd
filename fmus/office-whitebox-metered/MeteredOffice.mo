within ;
package MeteredOffice "The white-box office, driven by what a building automation records"

  model Office "White-box office whose sky, wind, facade sun and gains are guessed from few recordings"
    parameter Real cSlab(unit="J/(m2.K)", min=0) = 3.75e5 "Heat capacity of the slab around and above the pipes";
    parameter Real gSlab(unit="W/(m2.K)", min=0) = 17.0 "Conductance between the ceiling's surface and the pipes";
    parameter Real GWater(unit="W/K", min=0) = 110.0 "Pipe to slab core at full flow";
    parameter Real gCavity(unit="W/(m2.K)", min=0) = 1.2 "Conductance of the cavity under the raised floor";
    parameter Real hStill(unit="W/(m2.K)", min=0) = 0.6 "Coefficient that room air currents keep up";
    parameter Real kConvection(unit="1", min=0) = 1.0 "Factor on natural convection at all surfaces";
    parameter Real epsRoom(unit="1", min=0) = 0.9 "Emissivity of the room's surfaces";
    parameter Real gInsulation(unit="W/(m2.K)", min=0) = 0.5 "Conductance of the facade panel's insulation";
    parameter Real gGlazing(unit="W/(m2.K)", min=0) = 0.8 "Conductance of the gas between the panes";
    parameter Real ALeakage(unit="m2", min=0) = 1.0e-3 "Effective leakage area";
    parameter Real VSup(unit="m3/s", min=0) = 0.015 "Ventilation flow while it is on";
    parameter Real CAir(unit="J/K", min=0) = 6.6e4 "Heat capacity of the air with paper and textiles";
    parameter Real CFurniture(unit="J/K", min=0) = 1.2e5 "Heat capacity of the furniture";
    parameter Real cPartition(unit="J/(m2.K)", min=0) = 1.7e4 "Heat capacity of the partitions up to their middle";
    parameter Real cCorridor(unit="J/(m2.K)", min=0) = 3.3e4 "Heat capacity of the corridor wall up to its middle";
    parameter Real gSun(unit="1", min=0) = 0.03 "Solar transmittance of glazing and blinds";
    parameter Real fFacade(unit="1", min=0) = 0.8 "Irradiance on the facade relative to the horizontal one";
    parameter Real QOccupied(unit="W", min=0) = 150.0 "Heat of people, equipment and light at full occupancy";
    parameter Real dTSky(unit="K", min=0) = 12.0 "How much colder than the air the sky is";
    parameter Real vWind(unit="m/s", min=0) = 3.5 "Wind speed";
    parameter Real TSlabInit(unit="K", min=0) = 298.15 "Temperature of the slab at the start";
    parameter Real TRoomInit(unit="K", min=0) = 296.15 "Room-side temperatures at the start";
    parameter Real TFacadeInit(unit="K", min=0) = 275.15 "Facade skin temperature at the start";

    input Real TAmb(unit="K", start=273.15) "Outdoor air temperature";
    input Real TSupTAC(unit="K", start=300.15) "Supply temperature of the thermoactive ceiling";
    input Real ySupTAC(unit="1", start=0) "Flow in the thermoactive ceiling, relative";
    input Real TSupMV(unit="K", start=294.15) "Supply temperature of the ventilation";
    input Real ySupMV(unit="1", start=0) "Ventilation flow, relative";
    input Real HGlo(unit="W/m2", start=0) "Global horizontal radiation";
    input Real occ(unit="1", start=0) "Occupancy between 0 and 1";
    output Real TRoom(unit="K") "Temperature of the room sensor";

    WhiteBoxOffice.Office room(
      TRoomStart=TRoomInit, TFacadeStart=TFacadeInit,
      VSupply=VSup, GPipe=GWater, gGlass=gSun, fBlind=1.0, QPerson=70.0,
      air(C=CAir), furniture(C=0.5*CFurniture), furnitureCore(C=0.5*CFurniture),
      partition(C=27.0*0.47*cPartition), partitionCore(C=27.0*0.53*cPartition),
      corridor(C=8.0*0.333*cCorridor), corridorCore(C=8.0*0.667*cCorridor),
      slabLow(C=12.72*0.280*cSlab, TStart=TSlabInit), core(C=12.72*0.293*cSlab, TStart=TSlabInit),
      slabHigh(C=12.72*0.427*cSlab, TStart=TSlabInit), ceiling(TStart=0.5*(TRoomInit + TSlabInit)),
      slab1(G=12.72*2.333*gSlab), slab2(G=12.72*1.75*gSlab), slab4(G=12.72*gCavity),
      wallInsulation1(G=4.888*4.0*gInsulation), wallInsulation2(G=4.888*2.0*gInsulation),
      wallInsulation3(G=4.888*4.0*gInsulation), glazingGap(G=2.626*gGlazing),
      convectionFurniture(hMix=hStill, kWarm=1.31*kConvection, kCold=1.31*kConvection),
      convectionPartition(hMix=hStill, kWarm=1.31*kConvection, kCold=1.31*kConvection),
      convectionCorridor(hMix=hStill, kWarm=1.31*kConvection, kCold=1.31*kConvection),
      convectionWall(hMix=hStill, kWarm=1.31*kConvection, kCold=1.31*kConvection),
      convectionPane(hMix=hStill, kWarm=1.31*kConvection, kCold=1.31*kConvection),
      convectionCeiling(hMix=hStill, kWarm=0.76*kConvection, kCold=1.52*kConvection),
      convectionFloor(hMix=hStill, kWarm=1.52*kConvection, kCold=0.76*kConvection),
      radiationFurniture(epsilon=epsRoom), radiationPartition(epsilon=epsRoom),
      radiationCorridor(epsilon=epsRoom), radiationWall(epsilon=epsRoom),
      radiationCeiling(epsilon=epsRoom), radiationFloor(epsilon=epsRoom),
      leak(ALeak=ALeakage)) "The room";
  equation
    room.TAmb = TAmb;
    room.TSky = TAmb - dTSky;
    room.vWind = vWind;
    room.IBeam = 0.0;
    room.IDiffuse = fFacade*HGlo;
    room.cosIncidence = 0.0;
    room.TSupTAC = TSupTAC;
    room.ySupTAC = ySupTAC;
    room.TSupMV = TSupMV;
    room.ySupMV = ySupMV;
    room.nPeople = 0.45*QOccupied/70.0*occ;
    room.QEquipment = 0.4*QOccupied*occ;
    room.QLight = 0.15*QOccupied*occ;
    room.AOpen = 0.0;
    TRoom = room.TSensor;
  end Office;
end MeteredOffice;
