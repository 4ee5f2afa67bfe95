"""Our own vehicles, one class a size and kind, with pinned parameters.

A class a size, because an object whose LENGTH is set on the instance keeps the collision radius of
its class.  Every parameter of the driver model is pinned on our own classes, because creating an
intersection rewrites those of the stock `IDMVehicle` for the whole process.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from pmbm.labels import Label
from pmbm.sim.world.highway.env import ControlledVehicle, IDMVehicle, Vehicle


class Car(IDMVehicle):  # type: ignore[misc]
    """A car that follows its leader (IDM) and may change lane (MOBIL).

    The values are those of highway-env 1.12; sources: Treiber et al. 2000 (IDM), Kesting et
    al. 2007 (MOBIL).  Distances in m between centres, speeds in m/s, accelerations in m/s^2.
    """

    LENGTH = 5.0
    WIDTH = 2.0
    ACC_MAX = 6.0
    COMFORT_ACC_MAX = 3.0
    COMFORT_ACC_MIN = -5.0
    DISTANCE_WANTED = 10.0
    TIME_WANTED = 1.5
    DELTA = 4.0
    DELTA_RANGE = (3.5, 4.5)
    POLITENESS = 0.0
    LANE_CHANGE_MIN_ACC_GAIN = 0.2
    LANE_CHANGE_MAX_BRAKING_IMPOSED = 2.0
    LANE_CHANGE_DELAY = 1.0

    label = Label.CAR


class IntersectionCar(Car):
    """The car of intersections, which write their own headways onto its class."""


class Cruiser(ControlledVehicle):  # type: ignore[misc]
    """A car that keeps its lane and its target speed and looks at nobody."""

    LENGTH = 5.0
    WIDTH = 2.0

    label = Label.CAR


@functools.cache
def vehicle_class(driver: str, label: Label, length: float, width: float) -> type[Any]:
    """The class of vehicles with this driver ("idm" or "cruise"), kind and size in metres."""
    base: type[Any] = {"idm": Car, "cruise": Cruiser}[driver]
    if (label, length, width) == (base.label, base.LENGTH, base.WIDTH):
        return base
    members: dict[str, Any] = {"label": label, "LENGTH": length, "WIDTH": width}
    if driver == "idm":
        # The wanted distance is between centres: the same bumper gap at every length.
        members["DISTANCE_WANTED"] = Car.DISTANCE_WANTED - Car.LENGTH + length
    return type(f"{label.name.title()}{base.__name__}", (base,), members)


def as_car(vehicle: Vehicle) -> Car:
    """A car driven by IDM in the state, and on the route, of another vehicle."""
    return Car(
        vehicle.road,
        np.array(vehicle.position),
        heading=float(vehicle.heading),
        speed=float(vehicle.speed),
        target_lane_index=getattr(vehicle, "target_lane_index", None),
        target_speed=float(getattr(vehicle, "target_speed", vehicle.speed)),
        route=getattr(vehicle, "route", None),
    )


def label_of(vehicle: Vehicle) -> Label:
    """The kind of a vehicle; highway-env's own classes are all cars."""
    return getattr(type(vehicle), "label", Label.CAR)
