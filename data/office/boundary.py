"""What acts on the virtual office: a cold, clear spell between two mild, cloudy weeks, services and people.

Only this module knows pvlib.
"""

import numpy as np
import pandas as pd
import pvlib
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

Array = NDArray[np.float64]

STEP_S = 60
DAY_S = 86400
WARM_UP_DAYS = 12  # simulated before the first row, so that walls and slab have a history
RECORDED_DAYS = 22
DAYS = range(-WARM_UP_DAYS, RECORDED_DAYS)
FIRST_DAY = pd.Timestamp("2018-02-21", tz="Etc/GMT-1")  # a Wednesday, Central European Time
KELVIN = 273.15

LATITUDE, LONGITUDE, ALTITUDE_M = 53.5, 10.0, 10.0  # Hamburg
FACADE_AZIMUTH = 190.0  # degrees clockwise from north: a little west of south
LINKE_TURBIDITY = 2.6  # clear winter air; given here so that pvlib needs no map of it
WINDOW_OPENED_H = (20 * 24 + 13.5, 20 * 24 + 13.9)  # once, on day 20, as people do on a mild day

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


def make_boundary(weather_rng: np.random.Generator, operation_rng: np.random.Generator) -> pd.DataFrame:
    """Draw all that acts on the room, named as the inputs of the white-box FMU; temperatures are in degC.

    Args:
        weather_rng: Source of the weather's noise.
        operation_rng: Source of the noise of services and people.

    Returns:
        One row per step, by its start, zero at the first recorded row [s]: what the FMU's inputs are over it,
        and the global horizontal irradiance `IHorizontal` [W/m2].
    """
    t = np.arange(-WARM_UP_DAYS * DAY_S, RECORDED_DAYS * DAY_S, STEP_S, dtype=np.float64)
    made = pd.DataFrame(index=t)
    _add_weather(made, weather_rng, t)
    _add_operation(made, operation_rng, t)
    return made


def hour_of_day(t: Array) -> Array:
    """Return the local hour. Shape (t,). [h]."""
    return 24.0 * np.mod(t / DAY_S, 1.0)


def red_noise(rng: np.random.Generator, n: int, correlation_s: float) -> Array:
    """Draw a first-order autoregressive series of unit variance on the simulation grid. Shape (n,). [1]."""
    decay = float(np.exp(-STEP_S / correlation_s))
    shocks = rng.standard_normal(n) * np.sqrt(1.0 - decay**2)
    series = np.empty(n)
    level = float(rng.standard_normal())
    for i, shock in enumerate(shocks):
        level = decay * level + shock
        series[i] = level
    return series


def lagged(series: Array, lag_s: Array | float) -> Array:
    """Return the first-order lag of a series; the lag may change with time. Shape (t,)."""
    share = -np.expm1(-STEP_S / np.broadcast_to(np.asarray(lag_s, dtype=np.float64), series.shape))
    out = np.empty_like(series)
    level = float(series[0])
    for i, (target, weight) in enumerate(zip(series, share, strict=True)):
        level += weight * (target - level)
        out[i] = level
    return out


def _add_weather(made: pd.DataFrame, rng: np.random.Generator, t: Array) -> None:
    """Synthesize the weather at the middle of each step: trends set by hand, noise, sun by pvlib.

    Radiation under clouds follows Kasten and Czeplak (doi 10.1016/0038-092X(80)90391-6), the clear sky's
    emissivity Berdahl and Martin (doi 10.1016/0038-092X(84)90144-0) with a dew point 4 K below the air.
    """
    day, hour = (t + STEP_S / 2) / DAY_S, hour_of_day(t + STEP_S / 2)

    def follow(trend: dict[float, float]) -> Array:
        return PchipInterpolator(list(trend), list(trend.values()))(day)

    cloud = np.clip(follow(CLOUD_TREND) + 0.16 * red_noise(rng, t.size, 3 * 3600.0), 0.0, 1.0)
    swing = 0.8 + 3.0 * (1.0 - lagged(cloud, 12 * 3600.0))
    outdoor = follow(OUTDOOR_TREND) + swing * np.cos(2 * np.pi * (hour - 15.0) / 24.0)
    outdoor += 0.7 * lagged(red_noise(rng, t.size, 6 * 3600.0), 1800.0)
    dew_point = (outdoor - 4.0) / 100.0
    clear_emissivity = 0.711 + 0.56 * dew_point + 0.73 * dew_point**2
    emissivity = clear_emissivity + 0.85 * (1.0 - clear_emissivity) * cloud
    made["TAmb"], made["TSky"] = outdoor, (outdoor + KELVIN) * emissivity**0.25 - KELVIN
    made["vWind"] = follow(WIND_TREND) * np.exp(0.35 * red_noise(rng, t.size, 4 * 3600.0) - 0.06)

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
    for name, series in (
        ("IHorizontal", total),
        ("IBeam", plane["poa_direct"]),
        ("IDiffuse", plane["poa_diffuse"]),
    ):
        made[name] = np.nan_to_num(np.asarray(series, dtype=np.float64))
    made["cosIncidence"] = np.maximum(np.asarray(incidence, dtype=np.float64), 0.0)


def _add_operation(made: pd.DataFrame, rng: np.random.Generator, t: Array) -> None:
    """Run ceiling and ventilation by curve and schedule, and let a person come and go."""
    outdoor, hour = made["TAmb"].to_numpy(), hour_of_day(t)
    which_day = np.floor(t / DAY_S).astype(np.int64)
    weekday = {day: int(FIRST_DAY.day_of_week + day) % 7 for day in DAYS}  # Monday is 0

    # The ceiling: heating curve, night boost, midday pause, heating limit.
    is_night = (hour < 6.7) | (hour > 19.0)
    curve = 24.1 - 0.30 * (lagged(outdoor, 10 * 3600.0) - 3.0) + np.where(is_night, 1.4, -1.0)
    curve += 0.5 * red_noise(rng, t.size, 2 * 3600.0)
    running = np.ones(t.size, dtype=bool)
    for day in DAYS:
        start, length = rng.normal([9.3, 3.0], [0.5, 1.0])
        if rng.random() < 0.8:
            running[(which_day == day) & (hour > start) & (hour < start + length)] = False
    running &= lagged(outdoor, 24 * 3600.0) < 6.0
    standing = 23.0 + 0.1 * red_noise(rng, t.size, 6 * 3600.0)
    made["TSupTAC"] = lagged(np.where(running, curve, standing), np.where(running, 1500.0, 6 * 3600.0))
    made["ySupTAC"] = running.astype(np.float64)

    # The ventilation, in office hours.
    day_of_week = np.array([weekday[day] for day in DAYS])[which_day + WARM_UP_DAYS]
    running = (day_of_week < 5) & (hour >= 7.25) & (hour < np.where(day_of_week == 4, 17.25, 18.25))
    standing = 20.0 + 0.04 * (lagged(outdoor, 10 * 3600.0) - 2.0)
    supply = lagged(np.where(running, 21.0, standing), np.where(running, 1800.0, 7200.0))
    made["TSupMV"] = supply + 0.05 * red_noise(rng, t.size, 3600.0)
    made["ySupMV"] = running.astype(np.float64)

    # One person, minute by minute: arrival, lunch, departure, errands.
    people = np.zeros(t.size)
    for day in DAYS:
        arrival, lunch, departure = rng.normal([8.3, 12.2, 16.6], [0.5, 0.3, 0.8])
        absent = rng.random() < 0.12
        errands = rng.random(DAY_S // STEP_S)
        if weekday[day] >= 5 or absent:
            continue
        away = False
        for row, draw in zip(np.flatnonzero(which_day == day), errands, strict=True):
            away = draw > 0.04 if away else draw < 0.012
            at_desk = arrival < hour[row] < departure and not lunch < hour[row] < lunch + 0.7
            people[row] = float(at_desk and not away)
    made["nPeople"] = people
    made["QEquipment"] = 10.0 + lagged(52.0 * people, 900.0)
    made["QLight"] = 28.0 * people * (made["IHorizontal"].to_numpy() < 120.0)
    is_open = (t / 3600.0 >= WINDOW_OPENED_H[0]) & (t / 3600.0 < WINDOW_OPENED_H[1])
    made["AOpen"] = np.where(is_open, 0.02, 0.0)
