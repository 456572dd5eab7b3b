"""Settings of contact in time stepping (`tossid.physics.simulate`): speeds and heights that decide between cases."""

from __future__ import annotations

from dataclasses import dataclass

from tossid.settings.kinds import Checked, NonNegative, Positive


@dataclass(frozen=True, kw_only=True)
class ContactSettings(Checked):
    """Where impacts begin, below which speed nothing bounces, and how noise is taken out of the ground."""

    bounce_speed: NonNegative = 0.02
    """speed of approach below which restitution does not act [m/s], that of a fall from 0.02 mm: without it, a body at
    rest would bounce on in ever shorter bounces. Own choice; Box2D has the same threshold, at 1 m/s"""
    recovery_speed: Positive = 0.02
    """speed at which a corner that begins in rigid ground comes out of it [m/s]: recorded states lie in the ground by
    their noise, and depth over time step would be a kick. Own choice; Chrono and ODE limit the same speed"""
    impact_speed: Positive = 0.1
    """speed at which a corner has to cross the ground for a time step to end there [m/s], where steps end at impacts
    (docs/adr/0010): a slower one moves less than 0.2 mm in a step of 1/592 s. Own choice"""
    touching_height: Positive = 5e-5
    """height up to which a corner touches rigid ground, where steps end at impacts [m]; in steps below 1.7 ms, 0.03 m/s
    times the step. An impact at 0.8 m/s is then too slow by at most 6e-4 m/s. Own choice"""
    adhesion_reach: NonNegative = 5e-4
    """height up to which adhesion pulls at a corner that carried no load in the last step [m]. Own choice"""
