"""A planar die analysed by hand, from TUM files of drops in the x-z plane.

    python -m experiments.by_hand.die FOLDER

Nothing of the diagnosis takes part. One linear fit to stretches of flight gives gravity, drag and the centre of mass.
Lines of flight either side of an impact have to join, which says when it was and how many frames were lost there. The
velocities give rebound, sliding friction, the radius of gyration and that of the corners. The unit is the drop:
intervals are of the same figures over resampled drops. docs/results/by-hand.md has the result.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from experiments.by_hand.die_flight import Flight, flights_of, of_first_flight, of_flight
from experiments.by_hand.die_impacts import (
    MOST_LOST,
    Impact,
    contacts,
    correlations_of_impacts,
    impacts,
    of_impacts,
    radius_by_spin,
    scatter_of_impacts,
)
from experiments.by_hand.die_recording import (
    Drop,
    floor_of,
    halves,
    heights_by_face,
    lost_in_flight,
    read_drop,
    with_true_times,
)
from experiments.by_hand.fits import with_interval

Array = NDArray[np.float64]
Shown = TypeVar("Shown", Flight, Impact)

RESAMPLES = 200
"""Draws of drops for each interval."""
PLACES = 0.05
"""Width of the stretches of floor by which rebound is listed [m]."""


def by_drop(some: Sequence[Shown]) -> list[list[Shown]]:
    """Flights or impacts, those of a drop together."""
    return [[each for each in some if each.drop == name] for name in sorted({each.drop for each in some})]


def by_place(some: list[Impact]) -> dict[float, tuple[Array, Array]]:
    """Rebounds of first (n,) and of later (m,) impacts, by where the stretch of floor begins on which they were [m]."""
    places = np.floor(np.array([i.place for i in some]) / PLACES)
    first, rebound = np.array([i.first for i in some]), contacts(some, radius_by_spin(some)[0]).rebound
    return {
        float(k * PLACES): (rebound[(places == k) & first], rebound[(places == k) & ~first]) for k in np.unique(places)
    }


def main() -> None:
    """Print the tables of a folder of drops."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", type=float, default=0.03, help="half of the die's side [m]")
    given = parser.parse_args()
    recorded = [read_drop(path) for path in sorted(given.folder.glob("*.txt"))]
    heights = heights_by_face(recorded)
    half = halves(heights, given.half)
    lost = [lost_in_flight(drop, half) for drop in recorded]
    drops = [with_true_times(drop, each) for drop, each in zip(recorded, lost, strict=True)]
    flying = [flight for drop in drops for flight in flights_of(drop, half)]
    later = [f for f in flying if not f.first]
    flight = of_flight(later)
    centre = 1e-3 * np.array([flight[f"centre of mass, {axis} [mm]"] for axis in "xz"])
    every = [hit for drop in drops for hit in impacts(drop, half, centre, flight["drag [1/s]"])]
    hits = [hit for hit in every if hit.lost is not None]

    _at_rest(drops, heights, half)
    print("\n| of | figure | value | 95 % interval | drops |\n|---|---|---|---|---|")
    _print("before the first impact", [f for f in flying if f.first], of_first_flight)
    _print("after it", later, of_flight)
    _print("impacts of a lone corner", hits, of_impacts)
    for where, some in (("first ones", [h for h in hits if h.first]), ("later ones", [h for h in hits if not h.first])):
        _print(where, some, of_impacts)

    print("\n| impacts of a lone corner | lost 0 frames | 1 | 2 | 3 | do not join |\n|---|---|---|---|---|---|")
    for where, first in (("first", True), ("later", False)):
        some_lost = [hit.lost for hit in every if hit.first == first]
        counts = [str(some_lost.count(n)) for n in (*range(MOST_LOST + 1), None)]
        print(f"| {where} | {' | '.join(counts)} |")
    for n in (0, 1):
        due = 1e3 * np.array([hit.due for hit in hits if hit.first and hit.lost == n])
        print(f"first impacts that lost {n}: the frame after them was due after [ms] {_spread(due)}")
    gaps = [each[each > 0] for each in lost]
    drops_with = sum(len(each) > 0 for each in gaps)
    print(f"in flight: {sum(map(len, gaps))} gaps of {sum(map(sum, gaps))} frames in all, in {drops_with} drops")

    print("\n| over impacts | 5 % | 25 % | 50 % | 75 % | 95 % |\n|---|---|---|---|---|---|")
    for name, quantiles in scatter_of_impacts(hits).items():
        print(f"| {name} | {' | '.join(f'{x:.3g}' for x in quantiles)} |")
    print("\n| rank correlation with | rebound | change of spin less that of its impulse |\n|---|---|---|")
    for name, (rebound, spin) in correlations_of_impacts(hits).items():
        print(f"| {name} | {rebound:.2f} | {spin:.2f} |")
    print("\n| x of the impact [m] | rebound: first ones | later ones |\n|---|---|---|")
    for begin, each in by_place(hits).items():
        print(f"| {begin:.2f} to {begin + PLACES:.2f} | {' | '.join(map(_spread, each))} |")


def _spread(values: Array) -> str:
    """The median, 10 and 90 %, and the count of some values."""
    if len(values) == 0:
        return "none"
    low, middle, high = np.percentile(values, [10, 50, 90])
    return f"{middle:.3g} ({low:.3g} to {high:.3g}; {len(values)})"


def _at_rest(drops: list[Drop], heights: Array, half: Array) -> None:
    print("| at rest on face | 0 | 1 | 2 | 3 |\n|---|---|---|---|---|")
    print(f"| height of the middle [mm] | {' | '.join(f'{1e3 * z:.2f}' for z in heights)} |")
    print(f"\nsides: {2e3 * half[0]:.2f} by {2e3 * half[1]:.2f} mm")
    floors = 1e3 * np.array([floor_of(drop, half) for drop in drops])
    for begin in range(0, len(drops), 25):
        some, names = floors[begin : begin + 25], [drop.name for drop in drops[begin : begin + 25]]
        print(f"floor under {names[0]} to {names[-1]} [mm]: {np.nanmedian(some):.2f}")


def _print(where: str, some: Sequence[Shown], figures: Callable[[list[Shown]], Mapping[str, float]]) -> None:
    count = len({each.drop for each in some})
    rows = with_interval(by_drop(some), figures, RESAMPLES) if some else {}
    for name, (value, low, high) in rows.items():
        print(f"| {where} | {name} | {value:.3g} | {low:.3g} to {high:.3g} | {count} |")


if __name__ == "__main__":
    main()
