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
RESOLVED = 50.0
"""Length of a chain, in autocorrelation times, from which that time is trusted (emcee's rule)."""

_LISTENED = 32  # walkers enough to estimate the autocorrelation time from


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
    fingerprint: str = "",
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
        checkpoint: HDF5 file (emcee's backend) that a later run with the same fingerprint continues.
        fingerprint: names problem and settings; a file with another one is refused.
        report: called at every look at the chain.
        moves: emcee moves with weights, by default :func:`~rotorfit.estimators.moves.mixture`.

    Raises:
        ValueError: too few walkers, or a checkpoint of something else.
    """
    if walkers < 2 * target.size or walkers % 2:
        raise ValueError(
            f"walkers is {walkers}; {target.size} entries need an even number of at least {2 * target.size}"
        )
    memory = emcee.backends.Backend()
    sampler = emcee.EnsembleSampler(
        walkers, target.size, target, moves=moves or mixture(centre, covariance), backend=memory, vectorize=True
    )
    state = _resume(memory, checkpoint, fingerprint, (walkers, target.size)) if checkpoint else None
    if state is None:
        random = np.random.RandomState(seed)
        state = emcee.State(_start(target, centre, covariance, walkers, random), random_state=random.get_state())
    verdict = _assess(memory, ess) if memory.iteration else None
    while memory.iteration < max_steps and not (verdict and verdict.converged):
        count = min(max(CHUNK, memory.iteration // 5), max_steps - memory.iteration)
        pending = []
        for current in sampler.sample(state, iterations=count, skip_initial_state_check=True):
            state = current
            if checkpoint:
                pending.append(emcee.State(current, copy=True))
        if checkpoint:
            _write(checkpoint, fingerprint, memory, pending)
        verdict = _assess(memory, ess)
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


def _assess(memory: Any, ess: float) -> Chain:
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
    )


def _tau(chain: Float) -> Float:
    """Integrated autocorrelation time of each entry, infinite where nothing moves."""
    still = np.ptp(chain, axis=0).max(axis=0) == 0
    tau = np.full(chain.shape[2], np.inf)
    if (~still).any():
        # Centred and scaled, so that products keep their digits.
        moving = chain[:, :, ~still]
        moving = (moving - moving.mean(axis=(0, 1))) / moving.std(axis=(0, 1))
        tau[~still] = emcee.autocorr.integrated_time(moving, tol=0, has_walkers=True)
    return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)


# ---- checkpoints -----------------------------------------------------------------------------------------------------


def _write(path: Path, fingerprint: str, memory: Any, pending: list[Any]) -> None:
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
        group.attrs["fingerprint"] = fingerprint
        file.flush()
    with temporary.open("rb+") as raw:
        os.fsync(raw.fileno())
    os.replace(temporary, path)


def _resume(memory: Any, path: Path, fingerprint: str, shape: tuple[int, int]) -> Any | None:
    """Load a checkpoint into memory; ``None`` if there is none yet."""
    if not path.exists():
        return None
    stored = emcee.backends.HDFBackend(str(path), read_only=True)
    with h5py.File(path, "r") as file:
        known = file[stored.name].attrs.get("fingerprint", "") if stored.name in file else ""
    if known != fingerprint or stored.shape != shape:
        raise ValueError(
            f"checkpoint {path} belongs to another posterior (other data, model, priors, noise treatment or number of "
            "walkers): name another file, or remove it"
        )
    state = stored.get_last_sample()
    chain, density = stored.get_chain(), stored.get_log_prob()
    nothing = np.zeros(shape[0], dtype=bool)
    memory.reset(*shape)
    memory.grow(chain.shape[0], None)
    for coords, log_prob in zip(chain, density, strict=True):
        memory.save_step(emcee.State(coords, log_prob=log_prob, random_state=state.random_state), nothing)
    memory.accepted = stored.accepted
    return state
