"""Weather of the virtual measurement: a cold, clear spell between two mild, cloudy weeks in Hamburg.

Only this module knows pvlib.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pvlib
from grid import DAY_S, FIRST_DAY, STEP_S, Array, hour_of_day, lagged, red_noise
from scipy.interpolate import PchipInterpolator

LATITUDE = 53.5
LONGITUDE = 10.0
ALTITUDE_M = 10.0
FACADE_AZIMUTH = 190.0  # degrees clockwise from north: a little west of south
LINKE_TURBIDITY = 2.6  # clear winter air; given here so that pvlib needs no map of it
KELVIN = 273.15

# Trends that the noise rides on: day since the first row -> value.
OUTDOOR_TREND: dict[float, float] = {
    -12: 3.5, -6: 4.5, -2: 2.0, 0: 0.5, 2: 0.0, 4: -2.5, 6: -5.0, 7.5: -8.3, 9.5: -8.6,
    11: -6.0, 12: 0.0, 13.5: 3.5, 15: 2.0, 17: 5.0, 18.5: 8.5, 20: 7.0, 22: 3.5,
}  # fmt: skip
CLOUD_TREND: dict[float, float] = {
    -12: 0.85, -3: 0.8, 0: 0.8, 1.5: 0.6, 3: 0.7, 4.5: 0.75, 5.5: 0.1, 10: 0.1, 11: 0.4, 12: 0.85,
    13: 0.6, 14.5: 0.9, 15.5: 0.5, 17: 0.9, 18.5: 0.5, 19.5: 0.95, 22: 0.75,
}  # fmt: skip
WIND_TREND: dict[float, float] = {
    -12: 4.0, 0: 4.0, 3: 3.0, 6: 5.0, 8: 6.5, 10: 4.5, 12: 3.0, 14: 4.0, 17: 3.0, 20: 6.0, 22: 5.0,
}  # fmt: skip


@dataclass(frozen=True)
class Weather:
    """Weather at the middle of each simulation step; every array has shape (t,).

    Attributes:
        outdoor: Air temperature. [degC]
        sky: Effective sky temperature. [degC]
        wind: Wind speed. [m/s]
        horizontal: Global horizontal irradiance. [W/m2]
        facade_beam: Beam irradiance on the facade. [W/m2]
        facade_diffuse: Sky-diffuse and ground-reflected irradiance on the facade. [W/m2]
        cos_incidence: Cosine of the angle of incidence on the facade, at least 0. [1]
    """

    outdoor: Array
    sky: Array
    wind: Array
    horizontal: Array
    facade_beam: Array
    facade_diffuse: Array
    cos_incidence: Array


def _follow(trend: dict[float, float], day: Array) -> Array:
    return np.asarray(PchipInterpolator(list(trend), list(trend.values()))(day), dtype=np.float64)


def _on_facade(t: Array, cloud: Array) -> tuple[Array, Array, Array, Array]:
    """Return global horizontal, facade beam, facade diffuse irradiance and the cosine of incidence."""
    when = FIRST_DAY + pd.to_timedelta(t + STEP_S / 2, unit="s")
    sun = pvlib.solarposition.spa_python(when, LATITUDE, LONGITUDE, altitude=ALTITUDE_M)
    zenith, azimuth = sun["apparent_zenith"], sun["azimuth"]
    airmass = pvlib.atmosphere.get_absolute_airmass(pvlib.atmosphere.get_relative_airmass(zenith))
    day_of_year = when.tz_convert("UTC").day_of_year.to_numpy()
    extra = pvlib.irradiance.get_extra_radiation(day_of_year)
    clear = pvlib.clearsky.ineichen(zenith, airmass, LINKE_TURBIDITY, altitude=ALTITUDE_M, dni_extra=extra)
    total = clear["ghi"] * (1.0 - 0.75 * cloud**3.4)
    parts = pvlib.irradiance.erbs(total, zenith, day_of_year)
    plane = pvlib.irradiance.get_total_irradiance(
        90.0, FACADE_AZIMUTH, zenith, azimuth, parts["dni"], total, parts["dhi"], model="isotropic"
    )
    incidence = pvlib.irradiance.aoi_projection(90.0, FACADE_AZIMUTH, zenith, azimuth)
    total, beam, diffuse = (
        np.nan_to_num(np.asarray(series, dtype=np.float64))
        for series in (total, plane["poa_direct"], plane["poa_diffuse"])
    )
    return total, beam, diffuse, np.maximum(np.asarray(incidence, dtype=np.float64), 0.0)


def make_weather(rng: np.random.Generator, t: Array) -> Weather:
    """Synthesize the weather: trends set by hand, autoregressive noise, sun by pvlib.

    Radiation under clouds follows Kasten and Czeplak (doi 10.1016/0038-092X(80)90391-6), the clear sky's
    emissivity Berdahl and Martin (doi 10.1016/0038-092X(84)90144-0) with a dew point 4 K below the air.

    Args:
        rng: Source of the noise.
        t: Start of each step. Shape (t,). [s]

    Returns:
        The weather.
    """
    day, hour = (t + STEP_S / 2) / DAY_S, hour_of_day(t + STEP_S / 2)
    cloud = np.clip(_follow(CLOUD_TREND, day) + 0.16 * red_noise(rng, t.size, 3 * 3600.0), 0.0, 1.0)
    swing = 0.8 + 3.0 * (1.0 - lagged(cloud, 12 * 3600.0))
    outdoor = _follow(OUTDOOR_TREND, day) + swing * np.cos(2 * np.pi * (hour - 15.0) / 24.0)
    outdoor += 0.7 * lagged(red_noise(rng, t.size, 6 * 3600.0), 1800.0)
    wind = _follow(WIND_TREND, day) * np.exp(0.35 * red_noise(rng, t.size, 4 * 3600.0) - 0.06)
    horizontal, beam, diffuse, cos_incidence = _on_facade(t, cloud)
    dew_point = (outdoor - 4.0) / 100.0
    clear_emissivity = 0.711 + 0.56 * dew_point + 0.73 * dew_point**2
    emissivity = clear_emissivity + 0.85 * (1.0 - clear_emissivity) * cloud
    return Weather(
        outdoor=outdoor,
        sky=(outdoor + KELVIN) * emissivity**0.25 - KELVIN,
        wind=wind,
        horizontal=horizontal,
        facade_beam=beam,
        facade_diffuse=diffuse,
        cos_incidence=cos_incidence,
    )
