"""The rivals of `posterior_speed.py`: eq. (18) with Gaussian noise sampled by emcee on NumPy and by NumPyro on JAX.

Each takes bare arrays, as in `lmfit_rival.py`, and returns chains of shape ``(chains, draws, parameters)`` and the
processor time that they took. Parameters are in the order of ``ORDER``; their prior is flat.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

ORDER = ("Md", "Ds", "K1", "K2", "sigma", "Mb", "K0", "D", "lam", "Mf")


def log_density(x: Float, data: Mapping[str, Any]) -> float:
    """Log density of one vector, lines as arrays, one division in all."""
    Md, Ds, K1, K2, sigma, Mb, K0, D, lam, Mf = x
    w = data["w"]
    u = w - lam * data["speed"]
    disk = K1 + K2 - Md * w**2 + 1j * Ds * w
    journal = K0 + data["K3"] + K2 * sigma - Mb * w**2 - Mf * u**2 + 1j * D * u
    response = np.empty_like(data["measured"])
    response[0, 0], response[0, 1], response[1, 0], response[1, 1] = journal, K2 * sigma, K2, disk
    response *= 1.0 / (disk * journal - K2**2 * sigma)
    response -= data["measured"]
    response *= data["weight"]
    return -0.5 * float(np.vdot(response, response).real)


def numba_loop() -> Callable[..., None]:
    """The sum of squares of many vectors as one writes it by hand: ``loop(x, w, speed, K3, re, im, weight2, out)``."""
    import numba

    @numba.njit(fastmath={"contract", "reassoc", "arcp", "nsz"}, error_model="numpy")  # type: ignore[untyped-decorator]
    def loop(x: Any, w: Any, speed: float, K3: float, re: Any, im: Any, weight2: Any, out: Any) -> None:
        for v in range(x.shape[0]):
            Md, Ds, K1, K2, sigma, Mb, K0, D, lam, Mf = x[v]
            total = 0.0
            for line in range(w.size):
                f = w[line]
                u = f - lam * speed
                ar, ai = K1 + K2 - Md * f * f, Ds * f
                br, bi = K0 + K3 + K2 * sigma - Mb * f * f - Mf * u * u, D * u
                dr, di = ar * br - ai * bi - K2 * K2 * sigma, ar * bi + ai * br
                inverse = 1.0 / (dr * dr + di * di)
                r, i = re[0, line], im[0, line]
                total += ((br - r * dr + i * di) ** 2 + (bi - r * di - i * dr) ** 2) * inverse * weight2[0, line]
                r, i = re[1, line], im[1, line]
                total += ((K2 * sigma - r * dr + i * di) ** 2 + (r * di + i * dr) ** 2) * inverse * weight2[1, line]
                r, i = re[2, line], im[2, line]
                total += ((K2 - r * dr + i * di) ** 2 + (r * di + i * dr) ** 2) * inverse * weight2[2, line]
                r, i = re[3, line], im[3, line]
                total += ((ar - r * dr + i * di) ** 2 + (ai - r * di - i * dr) ** 2) * inverse * weight2[3, line]
            out[v] = total

    return loop  # type: ignore[no-any-return]


def emcee_by_hand(
    data: Mapping[str, Any], optimum: Float, *, steps: int, burn_in: int, seed: int, walkers: int = 32
) -> tuple[Float, float]:
    """emcee as its tutorial has it: a small ball around the optimum, stretch moves. Burn-in is not timed."""
    import emcee

    rng = np.random.default_rng(seed)
    start = optimum * (1 + 1e-4 * rng.normal(size=(walkers, optimum.size)))
    sampler = emcee.EnsembleSampler(walkers, optimum.size, log_density, args=(data,))
    sampler.random_state = np.random.RandomState(seed).get_state()
    state = sampler.run_mcmc(start, burn_in)
    sampler.reset()
    begin = time.process_time()
    sampler.run_mcmc(state, steps)
    return sampler.get_chain().transpose(1, 0, 2), time.process_time() - begin


def jax_potential(data: Mapping[str, Any], centre: Float, factor: Float) -> Callable[[Any], Any]:
    """Minus the log density on JAX, of coordinates z with ``x = centre + factor z``."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    w, measured, weight = (jnp.asarray(data[name]) for name in ("w", "measured", "weight"))
    speed, K3 = data["speed"], data["K3"]
    middle, spread = jnp.asarray(centre), jnp.asarray(factor)

    def potential(z: Any) -> Any:
        Md, Ds, K1, K2, sigma, Mb, K0, D, lam, Mf = middle + spread @ z
        u = w - lam * speed
        disk = K1 + K2 - Md * w**2 + 1j * Ds * w
        journal = K0 + K3 + K2 * sigma - Mb * w**2 - Mf * u**2 + 1j * D * u
        determinant = disk * journal - K2**2 * sigma
        rows = jnp.stack([jnp.stack([journal, 0 * w + K2 * sigma]), jnp.stack([0 * w + K2, disk])])
        miss = (rows / determinant - measured) * weight
        return 0.5 * jnp.sum(miss.real**2 + miss.imag**2)

    return potential


class Nuts:
    """NumPyro's NUTS in coordinates whitened by the normal approximation; compiled and adapted by the constructor.

    Sampling is one compiled loop over ``NUTS.sample``: ``MCMC.run`` would compile again at every call.

    Attributes:
        chain: the first draws, adaptation excluded.
    """

    def __init__(
        self, data: Mapping[str, Any], centre: Float, covariance: Float, *, draws: int, warm_up: int, seed: int
    ) -> None:
        import jax
        from numpyro.infer import NUTS

        scale = np.sqrt(np.diag(covariance))
        self._centre = centre
        self._factor = scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale))
        kernel = NUTS(potential_fn=jax_potential(data, centre, self._factor))
        state = kernel.init(jax.random.PRNGKey(seed), warm_up, np.zeros(centre.size), (), {})

        def steps(count: int) -> Callable[[Any], Any]:
            def one(state: Any, _: None) -> tuple[Any, Any]:
                state = kernel.sample(state, (), {})
                return state, state.z

            return jax.jit(lambda state: jax.lax.scan(one, state, None, length=count))

        self._state, _ = steps(warm_up)(state)
        self._run = steps(draws)
        self.chain, _ = self.again()

    def again(self) -> tuple[Float, float]:
        """As many draws again, from where the chain stands: no compiling, no adapting."""
        begin = time.process_time()
        self._state, z = self._run(self._state)
        chain = np.asarray(self._centre + np.asarray(z) @ self._factor.T)[None]
        return chain, time.process_time() - begin
