"""Sample a posterior with emcee until the autocorrelation time is resolved and enough independent draws are there."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np
from scipy.stats import multivariate_t

from rotorfit.base.array_types import RANK_TOLERANCE, Float
from rotorfit.base.atomic_file import whole_file
from rotorfit.base.file_reading import check_hdf5, check_seal, reading, seal
from rotorfit.estimators.inference.log_posterior import LogPosterior

RESOLVED_TIMES = 100.0
"""Length of a chain, in autocorrelation times, from which that time is trusted: twice emcee's rule, so that split
R-hat, which exceeds one by the autocorrelation time over the length, comes down to 1.01."""


@dataclass(frozen=True, kw_only=True)
class SamplerProgress:
    """State of a run."""

    steps: int  # made so far
    ess: float  # effective samples so far
    tau: float  # longest autocorrelation time in steps
    done: float = 0.0
    waiting: str = ""  # what is short, in words


@dataclass(frozen=True, eq=False, kw_only=True)
class WalkerPaths:
    """Walkers' paths."""

    draws: Float  # positions after burn-in, shape ``(steps, walkers, size)``
    log_density: Float  # up to a constant, shape ``(steps, walkers)``
    acceptance: Float  # accepted share of each walker's proposals, shape ``(walkers,)``
    tau: Float  # autocorrelation time of each entry in steps, shape ``(size,)``
    burn_in: int  # steps dropped at the beginning
    steps: int  # steps made in all, those of a resumed run included
    ess: float  # effective samples, ``walkers * kept steps / max(tau)``
    converged: bool  # whether the autocorrelation time is resolved and the effective samples asked for are there
    message: str  # what that means, in words
    seed: int  # of the random numbers


def sample(
    target: LogPosterior,
    centre: Float,
    covariance: Float,
    *,
    walkers: int,
    ess: float,
    max_steps: int,
    seed: int | None = None,
    checkpoint: Path | None = None,
    report: Callable[[SamplerProgress], None] | None = None,
    moves: list[tuple[Any, float]] | None = None,
) -> WalkerPaths:
    """Run emcee."""
    if walkers < 2 * target.size or walkers % 2:
        raise ValueError(
            f"walkers is {walkers}; {target.size} entries need an even number of at least {2 * target.size}"
        )
    memory = emcee.backends.Backend()
    memory.reset(walkers, target.size)
    learned, verdict = 0, None
    if checkpoint and checkpoint.exists():
        state, first_seed, learned = _resume(memory, checkpoint, target, walkers, seed)
        if memory.iteration > learned:
            verdict = _assess(memory, ess, first_seed, learned)
    else:
        first_seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
        random = np.random.RandomState(first_seed)
        state = emcee.State(
            starting_places(target, centre, covariance, walkers, random), random_state=random.get_state()
        )
    mixed = moves or mixture(target, *(_picture(memory, learned) if learned else (centre, covariance)))
    # Steps between looks at the chain (and checkpoints) at first; later a fifth of the chain's length.
    first_steps = 100
    while memory.iteration < max_steps and not (verdict and verdict.converged):
        count = min(max(first_steps, memory.iteration // 5), max_steps - memory.iteration)
        sampler = emcee.EnsembleSampler(walkers, target.size, target, moves=mixed, backend=memory, vectorize=True)
        state = sampler.run_mcmc(state, count, skip_initial_state_check=True)
        verdict = _assess(memory, ess, first_seed, learned)
        if not moves and _should_learn(memory, verdict, learned, max_steps):
            learned = memory.iteration
            mixed = mixture(target, *_picture(memory, learned))
        if checkpoint:
            _write(checkpoint, first_seed, learned, memory)
        if report:
            report(_progress(verdict, ess))
    if verdict is None:
        raise ValueError(f"max_steps is {max_steps}; at least one step is needed")
    return verdict


def _progress(verdict: WalkerPaths, ess: float) -> SamplerProgress:
    """How far a run is from what it must have to end."""
    longest, kept = float(verdict.tau.max()), verdict.draws.shape[0]
    samples, resolved = verdict.ess / ess, kept / (RESOLVED_TIMES * longest) if np.isfinite(longest) else 0.0
    if samples < resolved or samples < 1:
        words = f"{min(verdict.ess, ess):.0f} of {ess:.0f} effective samples"
    else:
        needed = RESOLVED_TIMES * longest
        words = f"{min(kept, needed):.0f} of the {needed:.0f} steps that resolve the autocorrelation time"
    done = 1.0 if verdict.converged else min(samples, resolved, 0.99)
    return SamplerProgress(steps=verdict.steps, ess=verdict.ess, tau=longest, done=done, waiting=words)


def _should_learn(memory: Any, verdict: WalkerPaths, learned: int, max_steps: int) -> bool:
    """True if the chain is slow and has doubled since the proposals were last learned, with as many steps to come."""
    steps = memory.iteration
    slow = not len(verdict.draws) >= 0.5 * RESOLVED_TIMES * verdict.tau.max()
    # Steps after which the independence proposals of a slow chain are adapted to the draws so far, and again whenever
    # the chain has doubled; what was drawn until then is burn-in, so that the proposals of the draws kept are fixed.
    first_learning = 500
    if not slow or not max(first_learning, 2 * learned) <= steps <= max_steps / 2:
        return False
    return bool((_picture(memory, steps)[1].diagonal() > 0).all())  # all entries have moved


def _picture(memory: Any, learned: int) -> tuple[Float, Float]:
    """Mean and covariance of the draws up to a step, its first half left out as burn-in."""
    draws = memory.get_chain()[learned // 2 : learned].reshape(-1, memory.shape[1])
    return draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))


def starting_places(
    target: LogPosterior, centre: Float, covariance: Float, walkers: int, random: np.random.RandomState
) -> Float:
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


def _assess(memory: Any, ess: float, seed: int, learned: int) -> WalkerPaths:
    """Autocorrelation time after burn-in, and what follows from it."""
    chain = memory.get_chain()
    steps, walkers, _ = chain.shape
    compared = 32  # walkers enough to tell whether their means differ
    tau = _tau(chain[max(steps // 4, learned) :, :: max(1, walkers // compared)])
    longest = float(tau.max())
    burn_in = int(min(max(10.0, 5 * longest), steps // 2)) if np.isfinite(longest) else steps // 2
    burn_in = max(burn_in, learned)
    kept = steps - burn_in
    effective = walkers * kept / longest if np.isfinite(longest) else 0.0
    resolved = kept >= RESOLVED_TIMES * longest
    if resolved and effective >= ess:
        message = f"converged: {effective:.0f} effective samples, autocorrelation time {longest:.1f} steps"
    elif resolved:
        message = f"not converged: {effective:.0f} of {ess:.0f} effective samples after {steps} steps"
    else:
        message = (
            f"not converged: the autocorrelation time, about {longest:.0f} steps, is not resolved by {kept} steps "
            f"({RESOLVED_TIMES:.0f} times its length are needed). Intervals may be too narrow: raise max_steps"
        )
    return WalkerPaths(
        draws=chain[burn_in:],
        log_density=memory.get_log_prob()[burn_in:],
        acceptance=np.asarray(memory.accepted / steps, dtype=float),
        tau=tau,
        burn_in=burn_in,
        steps=steps,
        ess=float(effective),
        converged=bool(resolved and effective >= ess),
        message=message,
        seed=seed,
    )


def _tau(chain: Float) -> Float:
    """Integrated autocorrelation time of each entry, infinite where nothing moves. emcee measures each walker from its
    own mean, so walkers that are stuck in places of their own look well mixed: where their means differ by much more
    than that time allows, the time that explains the difference takes its place."""
    still = np.ptp(chain, axis=0).max(axis=0) == 0
    tau = np.full(chain.shape[2], np.inf)
    timed_walkers = 16  # of them enough to estimate the autocorrelation time from
    spread_of_means = 4.0  # spread of 32 means over its expectation, beyond all chance (chi-squared over 31: p < 1e-12)
    if (~still).any():
        # Centred and scaled, so that products keep their digits.
        moving = chain[:, :, ~still]
        moving = (moving - moving.mean(axis=(0, 1))) / moving.std(axis=(0, 1))
        timed = moving[:, :: max(1, moving.shape[1] // timed_walkers)]
        with np.errstate(invalid="ignore"):  # a walker that never moves: NaN here, infinite below
            inner = emcee.autocorr.integrated_time(timed, tol=0, has_walkers=True)
        between = chain.shape[0] * moving.mean(axis=0).var(axis=0, ddof=1)
        tau[~still] = np.where(between > spread_of_means * np.maximum(inner, 1.0), between, inner)
    return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)


# ---- checkpoints -----------------------------------------------------------------------------------------------------


def _write(path: Path, seed: int, learned: int, memory: Any) -> None:
    """Put a checkpoint of emcee's layout in place in one go: a kill or a full disk leaves the old one whole."""
    content = io.BytesIO()  # the HDF5 library ends the process where a disk is full
    walkers, size = memory.shape
    with h5py.File(content, "w") as file:
        group = file.create_group("mcmc")
        group["accepted"] = memory.accepted
        group.create_dataset("chain", data=memory.get_chain(), maxshape=(None, walkers, size))
        group.create_dataset("log_prob", data=memory.get_log_prob(), maxshape=(None, walkers))
        group.attrs.update(version=emcee.__version__, nwalkers=walkers, ndim=size, has_blobs=False)
        group.attrs.update(iteration=memory.iteration, seed=seed, learned=learned)
        group.attrs.update({f"random_state_{number}": part for number, part in enumerate(memory.random_state)})
    with whole_file(path) as draft:
        draft.write_bytes(content.getbuffer())
        seal(draft)


def _resume(memory: Any, path: Path, target: LogPosterior, walkers: int, seed: int | None) -> tuple[Any, int, int]:
    """Load a checkpoint into memory: the walkers' last state, the seed, the step at which proposals were learned."""
    with reading(str(path), "checkpoint of a sampler"):
        check_seal(path, str(path))
        check_hdf5(path)
        stored = emcee.backends.HDFBackend(str(path), read_only=True)
        shape, state = stored.shape, stored.get_last_sample()
        chain, density, accepted = stored.get_chain(), stored.get_log_prob(), stored.accepted
        with h5py.File(path, "r") as file:
            attributes = file[stored.name].attrs
            first_seed, learned = (int(attributes[name]) for name in ("seed", "learned"))
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
    return state, first_seed, learned


DEGREES_OF_FREEDOM = 5.0
"""Tails of the independence proposal, heavy enough to reach the arms of a curved posterior."""

GOOD_EFFICIENCY = 0.6
"""Efficiency of importance sampling beyond which the proposal is taken to resemble the posterior."""


class IndependenceMove(emcee.moves.MHMove):  # type: ignore[misc]
    """Metropolis-Hastings step with proposals that do not depend on where the walker stands. Walkers move freely
    wherever the proposal resembles the posterior; where it does not, they stay, and the other moves of a mixture have
    to carry them. The factor is ``q(x) / q(x')`` (Tierney 1994, independence chains)."""

    def __init__(self, centre: Float, covariance: Float, df: float = DEGREES_OF_FREEDOM) -> None:
        # In units of the standard deviations, where the matrix is well scaled, and along directions that have a spread:
        # SciPy's density of a singular t distribution counts the others too.
        size = np.sqrt(np.diag(covariance))
        power, basis = np.linalg.eigh(covariance / np.outer(size, size))
        spread = power > RANK_TOLERANCE * power[-1]
        root = np.sqrt(power[spread])
        self.centre, self.df = centre, df
        self._colour = (size[:, None] * basis[:, spread] * root).T
        self._whiten = basis[:, spread] / root / size[:, None]
        self.proposal: Any = multivariate_t(np.zeros(root.size), np.eye(root.size), df=df)
        super().__init__(self.draw, centre.size)

    def draw(self, coords: Float, random: np.random.RandomState) -> tuple[Float, Float]:
        """Proposed positions and log Hastings factors."""
        white = self.white(len(coords), random)
        here = (coords - self.centre) @ self._whiten
        density = self.proposal.logpdf(np.concatenate([here, white]))
        return self.place(white), density[: len(coords)] - density[len(coords) :]

    def white(self, count: int, random: np.random.RandomState) -> Float:
        """Draws in units of the spread along each direction that has one, shape ``(count, rank)``."""
        return np.reshape(self.proposal.rvs(count, random_state=random), (count, -1))

    def place(self, white: Float) -> Float:
        """Positions of such draws, shape ``(count, p)``."""
        return np.asarray(self.centre + white @ self._colour)


def best_proposal(
    log_density: Callable[[Float], Float], centre: Float, covariance: Float
) -> tuple[IndependenceMove, float]:
    """The proposal whose tails suit the posterior best, and how much it resembles it. The measure is the efficiency of
    importance sampling, ``E(w)^2 / E(w^2)`` with weights ``w = p / q``: one where the proposal is the posterior itself.
    The same draws, from the heaviest tails, judge all."""
    heavy = IndependenceMove(centre, covariance)
    # The same where the proposal resembles the posterior: that of few readings with noise of unknown level is Student's
    # t itself, that of hundreds is normal. Tails stay heavier than the posterior's, so that walkers leave every place.
    lighter = (12.0, 50.0)
    moves = [heavy, *(IndependenceMove(centre, covariance, df) for df in lighter)]
    random = np.random.RandomState(0)  # the same answer when a run is resumed
    count = 512  # draws that the efficiency is estimated from
    drawn = heavy.white(count, random)
    value = log_density(heavy.place(drawn))
    if not np.isfinite(value.max()):
        return heavy, 0.0
    posterior = np.exp(value - value.max())
    proposed = [np.exp(move.proposal.logpdf(drawn)) for move in moves]
    mean = (posterior / proposed[0]).mean()
    efficiency = [float(mean**2 / (posterior**2 / (proposed[0] * one)).mean()) for one in proposed]
    first = int(np.argmax(efficiency))
    return moves[first], efficiency[first]


def mixture(log_density: Callable[[Float], Float], centre: Float, covariance: Float) -> list[tuple[Any, float]]:
    """Independence proposals mixed with moves that need no approximation: differential evolution and stretch."""
    independence, efficiency = best_proposal(log_density, centre, covariance)
    # Share of independence proposals at most: the rest keeps a chain moving where 512 draws have seen nothing.
    largest_share = 0.9
    share = min(efficiency, largest_share)
    if efficiency < GOOD_EFFICIENCY:
        independence, share = IndependenceMove(centre, covariance), 0.5
    return [
        (independence, share),
        (emcee.moves.DEMove(), 0.8 * (1 - share)),
        (emcee.moves.StretchMove(), 0.2 * (1 - share)),
    ]
