"""A tick of N robots as one function that JAX compiles: servo and physics, step by step.

It is compiled once for a number of robots and a structure of the model: masses, gains, gravity and
the number of physics steps are arguments, so that another robot like it needs no second time.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from unicon_core.platforms.kit.start import Start


class Places(NamedTuple):
    """Where joints and the free joint stand in `qpos` and `qvel`; a base that is fixed has none."""

    pos: tuple[int, ...]
    vel: tuple[int, ...]
    floating: bool
    base_pos: int
    base_vel: int

    @classmethod
    def of(cls, model: Any, start: Start) -> Places:
        """Return those of a robot in a model."""
        joints, base = start.loaded.joints, start.loaded.base
        pos, vel = model.jnt_qposadr[joints].tolist(), model.jnt_dofadr[joints].tolist()
        if base is None:
            return cls(tuple(pos), tuple(vel), False, 0, 0)
        at = int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base])
        return cls(tuple(pos), tuple(vel), True, *at)


@cache
def compiled_tick(places: Places) -> Any:
    """Return (model, limits, factor, data, command, steps) to (data, what is told).

    `limits` of the torque have shape (2, n), `factor` (n,), the command (5, N, n); told are `pos`,
    `vel`, `torque`, `base` and, one physics step before, `before`: qpos and qvel of the free joint.
    The servo's equation is that of `kit/servo.py`.
    """
    import jax
    from mujoco import mjx

    jnp = jax.numpy
    pos, vel = jnp.array(places.pos), jnp.array(places.vel)

    def where(data: Any) -> Any:
        if not places.floating:
            return jnp.zeros(13)
        at, by = places.base_pos, places.base_vel
        return jnp.concatenate((data.qpos[at : at + 7], data.qvel[by : by + 6]))

    def one(model: Any, limits: Any, factor: Any, data: Any, command: Any, steps: Any) -> Any:
        target, velocity, feed_forward, stiffness, damping = command

        def step(_: Any, carried: Any) -> Any:
            data, _, _ = carried
            error, slip = target - data.qpos[pos], velocity - data.qvel[vel]
            asked = stiffness * error + (damping * slip + feed_forward)
            torque = jnp.clip(asked, *limits) * factor
            applied = jnp.zeros_like(data.qfrc_applied).at[vel].set(torque)
            return mjx.step(model, data.replace(qfrc_applied=applied)), where(data), torque

        begin = (data, where(data), jnp.zeros_like(target))
        data, before, torque = jax.lax.fori_loop(0, steps, step, begin)
        told = {"pos": data.qpos[pos], "vel": data.qvel[vel], "torque": torque}
        return data, told | {"base": where(data), "before": before}

    return jax.jit(jax.vmap(one, in_axes=(None, None, None, 0, 1, None)))
