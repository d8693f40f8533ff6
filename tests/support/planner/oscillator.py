"""A part of a machine that rings: a damped oscillator that the acceleration of an axis excites."""

import numpy as np

from cnc.planner.plan import PlanChunk

STEP = 5e-4
"""s; the motion is read at this distance of time."""

Oscillator = tuple[int, float, float]
"""Column of the axis, frequency in Hz, damping ratio."""


def residuals(plans: list[PlanChunk], oscillators: list[Oscillator]) -> np.ndarray:
    """Return the amplitudes where the motion rests for a while, and at its end, mm.

    The relative place u of a mass on a spring that hangs on the axis follows
    u'' + 2 d w u' + w^2 u = -x''. Each change of the velocity of the axis is an impulse.
    Between them the motion is a decaying rotation of z = u' - s u, s = w (-d + i sqrt(1 - d^2)).

    Returns:
        (rests, oscillators).
    """
    columns = [column for column, _, _ in oscillators]
    w, d = np.array([(2.0 * np.pi * frequency, damping) for _, frequency, damping in oscillators]).T
    roots = w * (-d + 1j * np.sqrt(1.0 - d**2))
    rings, velocity = np.zeros(len(roots), complex), np.zeros(len(roots))
    amplitudes = []
    for number, plan in enumerate(plans):
        times = np.linspace(0.0, plan.duration, max(int(np.ceil(plan.duration / STEP)), 2) + 1)
        velocities = np.diff(plan.positions(times)[:, columns], axis=0) / times[1]
        impulses = np.diff(np.concatenate((velocity[None], velocities)), axis=0)
        decays = np.exp(np.outer(plan.duration - times[:-1], roots))
        rings = rings * np.exp(roots * plan.duration) - (impulses * decays).sum(axis=0)
        velocity = velocities[-1]
        if plan.phase_v[-1] == 0.0:
            rings, velocity = rings + velocity, np.zeros(len(roots))
        end = plan.t0 + plan.duration
        rest = plans[number + 1].t0 - end if number + 1 < len(plans) else 1.0
        if rest > 0.01:
            amplitudes.append(np.abs(rings / roots.imag))
        rings = rings * np.exp(roots * max(rest, 0.0))
    return np.array(amplitudes)
