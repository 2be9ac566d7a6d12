"""JAX: the top written for one body, mapped over the bodies in chunks that stay in the L1/L2 cache.

`reduced` and `general` are written as one writes JAX, on vectors and matrices; the `-rows` forms on
components, which become arrays over the bodies. XLA repeats shared terms in the kernel of every
component, so the general rows put barriers behind the multipliers and the stages; a flag keeps XLA
from dropping these. Cores are XLA devices, with a share of the bodies each.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from peers import equations as eq
from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {
    "reduced": Form("reduced", 8192, "JAX, vmap, reduced"),
    "reduced-rows": Form("reduced", 32768, "JAX, rows, reduced"),
    "general": Form("general", 256, "JAX, vmap, linalg.solve"),
    "general-rows": Form("general", 8192, "JAX, rows, saddle point"),
}
CHUNK = {"reduced": 256, "reduced-rows": 1024, "general": 256, "general-rows": 512}
FLAGS = "--xla_cpu_prefer_vector_width=512 --xla_disable_hlo_passes=cse_barrier_expander"


def available() -> str:
    return "" if find_spec("jax") else "jax is not installed"


def config() -> dict[str, object]:
    return {"jax": version("jax"), "XLA_FLAGS": FLAGS, "chunk": CHUNK}


def start_jax(threads: int):
    """Import JAX with a device for each thread."""
    os.environ["XLA_FLAGS"] = f"{FLAGS} --xla_force_host_platform_device_count={threads}"
    import jax

    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", True)
    return jax


def over_bodies(solve, chunk: int):
    """Compile the function of one body for chunks of bodies, spread over the devices."""
    import jax

    split = jax.sharding.PartitionSpec("core")
    mapped = jax.shard_map(
        lambda states: jax.lax.map(solve, states, batch_size=chunk),
        mesh=jax.sharding.Mesh(jax.devices(), "core"),
        in_specs=split,
        out_specs=split,
        check_vma=False,  # Diffrax starts loops from constants
    )
    return jax.jit(mapped)


def vector_rates(form: str):
    """State → rate, both vectors."""
    import jax.numpy as jnp

    inertia, centre = jnp.array((eq.J1, eq.J2, eq.J3)), jnp.array(eq.AXES.T @ top.CENTRE)
    weight = eq.MASS * top.GRAVITY

    def reduced(state):
        omega = state[4:]
        down = jnp.array(eq.matrix(*state[:4])).T @ weight
        torque = jnp.cross(centre, down) + jnp.cross(inertia * omega, omega)
        return jnp.concatenate((jnp.array(eq.turn_rates(*state)), torque / inertia))

    def general(state):
        omega = state[7:10]
        turn = jnp.array(eq.matrix(*state[:4]))
        jacobian = jnp.hstack((jnp.cross(turn, top.CENTRE), jnp.eye(3)))
        mass = jnp.diag(jnp.concatenate((top.INERTIA, jnp.full(3, top.MASS))))
        saddle = jnp.block([[mass, jacobian.T], [jacobian, jnp.zeros((3, 3))]])
        gyroscopic = jnp.cross(top.INERTIA * omega, omega)
        eta = turn @ jnp.cross(omega, jnp.cross(omega, top.CENTRE))
        acceleration = jnp.linalg.solve(saddle, jnp.concatenate((gyroscopic, weight, eta)))[:6]
        quaternion = jnp.array(eq.turn_rates(*state[:4], *omega))
        return jnp.concatenate((quaternion, state[10:], acceleration))

    return reduced if form == "reduced" else general


def vector_step(rates, y, h):
    k1 = rates(y)
    k2 = rates(y + h / 2 * k1)
    k3 = rates(y + h / 2 * k2)
    k4 = rates(y + h * k3)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    jax = start_jax(threads)
    _, start, final = eq.FORMS[form.removesuffix("-rows")]
    steps = round(top.T_END / accuracy)
    initial = start(omega0)
    if form.endswith("-rows"):
        initial, step = tuple(initial), eq.rk4_step
        rates = eq.reduced_rates if form == "reduced-rows" else _kept_rates
    else:
        initial, step, rates = np.ascontiguousarray(initial.T), vector_step, vector_rates(form)

    def solve(state):
        return jax.lax.fori_loop(0, steps, lambda _, y: step(rates, y, top.T_END / steps), state)

    compiled = over_bodies(solve, CHUNK[form])

    def integrate() -> Final:
        states = jax.device_get(compiled(initial))
        return final(np.array(states) if form.endswith("-rows") else states.T)

    return integrate


def _kept_rates(*state):
    from jax.lax import optimization_barrier

    return optimization_barrier(eq.general_rates(*state, keep=optimization_barrier))
