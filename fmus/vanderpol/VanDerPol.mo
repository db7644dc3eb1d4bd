within ;
package VanDerPol "Van der Pol's oscillator"

  model Oscillator "A circuit with a resistance that is negative for small voltages"
    parameter Real mu(unit="1", min=0) = 1 "Strength of the nonlinearity";
    parameter Real period(unit="s", min=1) = 7200 "Period of the linear circuit (mu = 0)";
    parameter Real amplitude(unit="V") = 1 "Voltage of x = 1; the oscillation settles near twice this";
    parameter Real xStart(unit="1") = 1 "x at the start";
    parameter Real vStart(unit="1") = 0 "v at the start";
    Real x(unit="1", start=xStart, fixed=true) "Voltage over amplitude";
    Real v(unit="1", start=vStart, fixed=true) "Rate of change of x over the angular frequency";
    Real omega(unit="1/s") "Angular frequency of the linear circuit";
    output Real U(unit="V") "Voltage";
  equation
    omega = 6.283185307179586/period;
    der(x) = omega*v;
    der(v) = omega*(mu*(1 - x*x)*v - x);
    U = amplitude*x;
  end Oscillator;

end VanDerPol;
