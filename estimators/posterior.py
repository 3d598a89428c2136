"""Sample a posterior with emcee until the autocorrelation time is resolved and enough independent draws are there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.moves import mixture
from rotorfit.estimators.target import Target

Float = NDArray[np.float64]

CHUNK = 100
"""Steps between looks at the chain (and checkpoints) at first; later a fifth of the chain's length."""
RESOLVED = 100.0
"""Length of a chain, in autocorrelation times, from which that time is trusted: twice emcee's rule, so that split
R-hat, which exceeds one by the autocorrelation time over the length, comes down to 1.01."""

_LISTENED = 32  # walkers enough to estimate the autocorrelation time from
_DISAGREE = 4.0  # spread of 32 means over its expectation, beyond all chance (chi-squared over 31: p < 1e-12)


@dataclass(frozen=True)
class Progress:
    """State of a run: steps made, effective samples so far, longest autocorrelation time in steps."""

    steps: int
    ess: float
    tau: float


@dataclass(frozen=True, eq=False)
class Chain:
    """Walkers' paths.

    Attributes:
        draws: positions after burn-in, shape ``(steps, walkers, size)``.
        log_density: up to a constant, shape ``(steps, walkers)``.
        acceptance: accepted share of each walker's proposals, shape ``(walkers,)``.
        tau: autocorrelation time of each entry in steps, shape ``(size,)``.
        burn_in: steps dropped at the beginning.
        steps: steps made in all, those of a resumed run included.
        ess: effective samples, ``walkers * kept steps / max(tau)``.
        converged: whether the autocorrelation time is resolved and the effective samples asked for are there.
        message: what that means, in words.
        seed: of the random numbers.
    """

    draws: Float
    log_density: Float
    acceptance: Float
    tau: Float
    burn_in: int
    steps: int
    ess: float
    converged: bool
    message: str
    seed: int


def sample(
    target: Target,
    centre: Float,
    covariance: Float,
    *,
    walkers: int,
    ess: float,
    max_steps: int,
    seed: int | None = None,
    checkpoint: Path | None = None,
    report: Callable[[Progress], None] | None = None,
    moves: list[tuple[Any, float]] | None = None,
) -> Chain:
    """Run emcee.

    Args:
        target: log density of many vectors.
        centre, covariance: normal approximation, start of the walkers and of the independence proposal.
        walkers: even, at least twice the size of the vector.
        ess: effective samples asked for.
        max_steps: steps after which to stop in any case.
        seed: of the random numbers; ``None`` takes one from the system.
        checkpoint: HDF5 file (emcee's backend), written at every look at the chain; a later run continues it.
        report: called at every look at the chain.
        moves: emcee moves with weights, by default :func:`~rotorfit.estimators.moves.mixture`.

    Raises:
        ValueError: too few walkers, or a checkpoint of another posterior, of other walkers or of another seed.
    """
    if walkers < 2 * target.size or walkers % 2:
        raise ValueError(
            f"walkers is {walkers}; {target.size} entries need an even number of at least {2 * target.size}"
        )
    memory = emcee.backends.Backend()
    sampler = emcee.EnsembleSampler(
        walkers, target.size, target, moves=moves or mixture(centre, covariance), backend=memory, vectorize=True
    )
    if checkpoint and checkpoint.exists():
        state, first_seed = _resume(memory, checkpoint, target, walkers, seed)
    else:
        first_seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
        random = np.random.RandomState(first_seed)
        state = emcee.State(_start(target, centre, covariance, walkers, random), random_state=random.get_state())
    verdict = _assess(memory, ess, first_seed) if memory.iteration else None
    while memory.iteration < max_steps and not (verdict and verdict.converged):
        count = min(max(CHUNK, memory.iteration // 5), max_steps - memory.iteration)
        pending = []
        for current in sampler.sample(state, iterations=count, skip_initial_state_check=True):
            state = current
            if checkpoint:
                pending.append(emcee.State(current, copy=True))
        if checkpoint:
            _write(checkpoint, first_seed, memory, pending)
        verdict = _assess(memory, ess, first_seed)
        if report:
            report(Progress(memory.iteration, verdict.ess, float(verdict.tau.max())))
    if verdict is None:
        raise ValueError(f"max_steps is {max_steps}; at least one step is needed")
    return verdict


def _start(target: Target, centre: Float, covariance: Float, walkers: int, random: np.random.RandomState) -> Float:
    """Walkers drawn from the normal approximation, those outside the bounds drawn again."""
    size = np.sqrt(np.diag(covariance))
    kept: list[Float] = []
    for _ in range(200):
        drawn = centre + size * random.multivariate_normal(
            np.zeros(centre.size), covariance / np.outer(size, size), walkers, check_valid="ignore"
        )
        kept += list(drawn[np.isfinite(target(drawn))])
        if len(kept) >= walkers:
            return np.array(kept[:walkers])
    raise ValueError(
        "no start for the walkers: almost all of the normal approximation at the optimum lies outside the bounds or "
        "the support of the priors"
    )


def _assess(memory: Any, ess: float, seed: int) -> Chain:
    """Autocorrelation time after burn-in, and what follows from it."""
    chain = memory.get_chain()
    steps, walkers, _ = chain.shape
    tau = _tau(chain[steps // 4 :, :: max(1, walkers // _LISTENED)])
    longest = float(tau.max())
    burn_in = int(min(max(10.0, 5 * longest), steps // 2)) if np.isfinite(longest) else steps // 2
    kept = steps - burn_in
    effective = walkers * kept / longest if np.isfinite(longest) else 0.0
    resolved = kept >= RESOLVED * longest
    if resolved and effective >= ess:
        message = f"converged: {effective:.0f} effective samples, autocorrelation time {longest:.1f} steps"
    elif resolved:
        message = f"not converged: {effective:.0f} of {ess:.0f} effective samples after {steps} steps"
    else:
        message = (
            f"not converged: the autocorrelation time, about {longest:.0f} steps, is not resolved by {kept} steps "
            f"({RESOLVED:.0f} times its length are needed). Intervals may be too narrow: raise max_steps"
        )
    return Chain(
        chain[burn_in:],
        memory.get_log_prob()[burn_in:],
        np.asarray(memory.accepted / steps, dtype=float),
        tau,
        burn_in,
        steps,
        float(effective),
        bool(resolved and effective >= ess),
        message,
        seed,
    )


def _tau(chain: Float) -> Float:
    """Integrated autocorrelation time of each entry, infinite where nothing moves.

    emcee measures each walker from its own mean, so walkers that are stuck in places of their own look well mixed:
    where their means differ by much more than that time allows, the time that explains the difference takes its place.
    """
    still = np.ptp(chain, axis=0).max(axis=0) == 0
    tau = np.full(chain.shape[2], np.inf)
    if (~still).any():
        # Centred and scaled, so that products keep their digits.
        moving = chain[:, :, ~still]
        moving = (moving - moving.mean(axis=(0, 1))) / moving.std(axis=(0, 1))
        inner = emcee.autocorr.integrated_time(moving, tol=0, has_walkers=True)
        between = chain.shape[0] * moving.mean(axis=0).var(axis=0, ddof=1)
        tau[~still] = np.where(between > _DISAGREE * np.maximum(inner, 1.0), between, inner)
    return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)


# ---- checkpoints -----------------------------------------------------------------------------------------------------


def _write(path: Path, seed: int, memory: Any, pending: list[Any]) -> None:
    """Append steps to a copy of the checkpoint and put it in place in one go: a kill leaves the old one whole."""
    temporary = path.with_name(path.name + ".part")
    if path.exists():
        shutil.copyfile(path, temporary)
    else:
        temporary.unlink(missing_ok=True)
    backend = emcee.backends.HDFBackend(str(temporary))
    if not backend.initialized:
        backend.reset(*memory.shape)
    backend.grow(len(pending), None)
    nothing = np.zeros(memory.shape[0], dtype=bool)
    for state in pending:
        backend.save_step(state, nothing)
    with h5py.File(temporary, "a") as file:
        group = file[backend.name]
        group["accepted"][:] = memory.accepted
        group.attrs["seed"] = seed
        file.flush()
    with temporary.open("rb+") as raw:
        os.fsync(raw.fileno())
    os.replace(temporary, path)


def _resume(memory: Any, path: Path, target: Target, walkers: int, seed: int | None) -> tuple[Any, int]:
    """Load a checkpoint into memory: the walkers' last state, with that of the random numbers, and the seed."""
    try:
        stored = emcee.backends.HDFBackend(str(path), read_only=True)
        shape, state = stored.shape, stored.get_last_sample()
        chain, density, accepted = stored.get_chain(), stored.get_log_prob(), stored.accepted
        with h5py.File(path, "r") as file:
            first_seed = int(file[stored.name].attrs["seed"])
    except (OSError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is no checkpoint of a sampler: {error}") from error
    if shape != (walkers, target.size):
        raise ValueError(
            f"checkpoint {path} holds {shape[0]} walkers of {shape[1]} entries, here are {walkers} of {target.size}: "
            "name another file, or remove it"
        )
    # The density itself tells whether data, model, priors and noise treatment are the same.
    if not np.allclose(target(state.coords), state.log_prob, rtol=1e-8, atol=1e-6):
        raise ValueError(
            f"checkpoint {path} belongs to another posterior (other data, model, priors or noise treatment): name "
            "another file, or remove it"
        )
    if seed is not None and seed != first_seed:
        raise ValueError(f"checkpoint {path} was begun with seed {first_seed}, not {seed}: name another file")
    nothing = np.zeros(walkers, dtype=bool)
    memory.reset(*shape)
    memory.grow(chain.shape[0], None)
    for coords, log_prob in zip(chain, density, strict=True):
        memory.save_step(emcee.State(coords, log_prob=log_prob, random_state=state.random_state), nothing)
    memory.accepted = accepted
    return state, first_seed
