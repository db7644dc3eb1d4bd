"""Building services and people of the virtual measurement."""

from dataclasses import dataclass

import numpy as np
from grid import (
    DAY_S,
    FIRST_DAY,
    RECORDED_DAYS,
    STEP_S,
    WARM_UP_DAYS,
    Array,
    day_number,
    hour_of_day,
    lagged,
    red_noise,
)
from weather import Weather

DAYS = range(-WARM_UP_DAYS, RECORDED_DAYS)
WINDOW_OPENED_H = (20 * 24 + 13.5, 20 * 24 + 13.9)  # once, on day 20, as people do on a mild day


@dataclass(frozen=True)
class Operation:
    """What services and people do during each simulation step; every array has shape (t,).

    Attributes:
        ceiling_supply: Supply temperature of the thermoactive ceiling. [degC]
        ceiling_on: Flow in the thermoactive ceiling, 0 or 1. [1]
        ventilation_supply: Supply temperature of the ventilation. [degC]
        ventilation_on: Ventilation flow, 0 or 1. [1]
        people: People in the room. [1]
        equipment: Heat of computers and screens. [W]
        light: Heat of the lighting. [W]
        window_opening: Effective area of an opened window. [m2]
    """

    ceiling_supply: Array
    ceiling_on: Array
    ventilation_supply: Array
    ventilation_on: Array
    people: Array
    equipment: Array
    light: Array
    window_opening: Array


def weekday(day: int) -> int:
    """Return the weekday (Monday is 0) of a day counted from the first row."""
    return int(FIRST_DAY.day_of_week + day) % 7


def _people(rng: np.random.Generator, t: Array) -> Array:
    """Draw one person's presence, minute by minute: arrival, lunch, departure, errands. Shape (t,). [1]."""
    present = np.zeros(t.size)
    hour, which_day = hour_of_day(t), day_number(t)
    for day in DAYS:
        arrival, lunch, departure = rng.normal([8.3, 12.2, 16.6], [0.5, 0.3, 0.8])
        absent = rng.random() < 0.12
        errands = rng.random(DAY_S // STEP_S)
        if weekday(day) >= 5 or absent:
            continue
        away = False
        for row, draw in zip(np.flatnonzero(which_day == day), errands, strict=True):
            away = draw > 0.04 if away else draw < 0.012
            at_desk = arrival < hour[row] < departure and not lunch < hour[row] < lunch + 0.7
            present[row] = float(at_desk and not away)
    return present


def _ceiling(rng: np.random.Generator, t: Array, outdoor: Array) -> tuple[Array, Array]:
    """Run the ceiling by heating curve, night boost, midday pause, heating limit: supply [degC], on [1]."""
    hour, which_day = hour_of_day(t), day_number(t)
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
    supply = lagged(np.where(running, curve, standing), np.where(running, 1500.0, 6 * 3600.0))
    return supply, running.astype(np.float64)


def _ventilation(rng: np.random.Generator, t: Array, outdoor: Array) -> tuple[Array, Array]:
    """Run the ventilation in office hours: supply temperature [degC], on [1]."""
    hour = hour_of_day(t)
    day_of_week = np.array([weekday(day) for day in DAYS])[day_number(t) + WARM_UP_DAYS]
    end = np.where(day_of_week == 4, 17.25, 18.25)
    running = (day_of_week < 5) & (hour >= 7.25) & (hour < end)
    standing = 20.0 + 0.04 * (lagged(outdoor, 10 * 3600.0) - 2.0)
    supply = lagged(np.where(running, 21.0, standing), np.where(running, 1800.0, 7200.0))
    return supply + 0.05 * red_noise(rng, t.size, 3600.0), running.astype(np.float64)


def make_operation(rng: np.random.Generator, t: Array, weather: Weather) -> Operation:
    """Run the services by curve and schedule, and let a person come and go.

    Args:
        rng: Source of the noise.
        t: Start of each step. Shape (t,). [s]
        weather: Weather on the same grid.

    Returns:
        What services and people do.
    """
    ceiling_supply, ceiling_on = _ceiling(rng, t, weather.outdoor)
    ventilation_supply, ventilation_on = _ventilation(rng, t, weather.outdoor)
    people = _people(rng, t)
    hours = t / 3600.0
    is_open = (hours >= WINDOW_OPENED_H[0]) & (hours < WINDOW_OPENED_H[1])
    return Operation(
        ceiling_supply=ceiling_supply,
        ceiling_on=ceiling_on,
        ventilation_supply=ventilation_supply,
        ventilation_on=ventilation_on,
        people=people,
        equipment=10.0 + lagged(52.0 * people, 900.0),
        light=28.0 * people * (weather.horizontal < 120.0),
        window_opening=np.where(is_open, 0.02, 0.0),
    )
