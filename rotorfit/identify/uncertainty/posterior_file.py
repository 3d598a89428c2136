"""Posterior samples as tables, for ArviZ, and in netCDF files."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.atomic_file import note_input, whole_file
from rotorfit.base.caches import cache_home
from rotorfit.base.digits import significant, with_error
from rotorfit.base.file_reading import reading, seal
from rotorfit.base.text_table import Table
from rotorfit.base.version import VERSIONS
from rotorfit.estimators.inference.caused_posterior import CausedPosterior
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import Posterior, SampleSettings
from rotorfit.identify.uncertainty.target import posterior_of
from rotorfit.lab.io.netcdf import load_dataset, write_dataset

if TYPE_CHECKING:
    import xarray as xr


_KIND = "rotorfit posterior"


@dataclass(frozen=True, kw_only=True)
class Health:
    """Convergence of the chains of one entry."""

    name: str  # of the entry
    rhat: float  # split R-hat, 1 for chains that agree, to be doubted above 1.01
    bulk: float  # effective samples for the middle of the distribution
    tail: float  # effective samples for its tails


def health(posterior: Posterior) -> list[Health]:
    """Split R-hat and effective samples of every entry, by ArviZ, walkers as chains."""
    az = load_arviz()

    found = []
    for i, name in enumerate(posterior.names):
        draws = posterior.chain[:, :, i].T
        # Quantiles whose effective sample size counts for the tails.
        bulk, tail = az.ess(draws, method="bulk"), az.ess(draws, method="tail", prob=(0.05, 0.95))
        found.append(Health(name=name, rhat=float(az.rhat(draws)), bulk=float(bulk), tail=float(tail)))
    return found


def summary(posterior: Posterior) -> list[str | Table]:
    """What is printed of draws: their table, with the chains' health."""
    state = posterior.settings
    lines = [
        posterior.message if posterior.converged else f"NOT CONVERGED: {posterior.message.partition(': ')[2]}",
        f"emcee, {state.walkers} walkers, {state.steps} steps of which {posterior.burn_in} burn-in, acceptance "
        f"{posterior.acceptance.mean():.2f}, seed {posterior.seed}",
        posterior.treatment,
        "",
    ]
    rows = [["parameter", "mean", "sd", "2.5 %", "median", "97.5 %", "R-hat", "bulk ESS", "tail ESS", "unit"]]
    for i, chains in enumerate(health(posterior)):
        draws = posterior.chain[:, :, i]
        low, middle, high = np.percentile(draws, (2.5, 50.0, 97.5))
        spread = float(draws.std(ddof=1))
        mean, *cells = (with_error(float(v), spread)[0] for v in (draws.mean(), low, middle, high))
        state_of = [f"{chains.rhat:.3f}", f"{chains.bulk:.0f}", f"{chains.tail:.0f}"]
        rows.append([chains.name, mean, significant(spread, 2), *cells, *state_of, posterior.unit(chains.name)])
    return [*lines, Table(rows, "<22 >13 >10 >13 >13 >13 >8 >10 >10 <1")]


def datasets(posterior: Posterior) -> dict[str, xr.Dataset]:
    """Groups in ArviZ's layout, walkers as chains: ``posterior`` and ``sample_stats``.

    Variables carry the names of the parameters, ``/`` written ``|``, and the name as it is in ``parameter``.
    """
    import xarray as xr

    steps, walkers, _ = posterior.chain.shape
    coords = {"chain": np.arange(walkers), "draw": np.arange(steps)}
    draws = {
        name.replace("/", "|"): (
            ("chain", "draw"),
            np.ascontiguousarray(posterior.chain[:, :, i].T),
            {"parameter": name, "units": posterior.unit(name), "position": i, "autocorrelation_time": posterior.tau[i]},
        )
        for i, name in enumerate(posterior.names)
    }
    stats: dict[str, Any] = {
        "lp": (("chain", "draw"), np.ascontiguousarray(posterior.log_density.T)),
        "acceptance_rate": (("chain",), posterior.acceptance),
    }
    if posterior.sizes is not None:
        stats["causes"] = (("chain", "draw", "cause"), np.ascontiguousarray(posterior.sizes.swapaxes(0, 1)))
    header = {
        "title": _KIND,
        "inference_library": "emcee",
        "created_by": f"rotorfit {VERSIONS}",
        "burn_in": posterior.burn_in,
        "converged": int(posterior.converged),
        "message": posterior.message,
        "treatment": posterior.treatment,
        "seed": str(posterior.seed),
        "settings": json.dumps(asdict(posterior.settings)),
    }
    return {"posterior": xr.Dataset(draws, coords, header), "sample_stats": xr.Dataset(stats, coords, header)}


def to_arviz(posterior: Posterior) -> Any:
    """``arviz.InferenceData`` with ArviZ before 1.0, ``xarray.DataTree`` from there on."""
    az = load_arviz()
    import xarray as xr

    groups = datasets(posterior)
    if int(az.__version__.partition(".")[0]) < 1:
        return az.InferenceData(**groups)
    return xr.DataTree.from_dict(groups)


def save(posterior: Posterior, path: Path) -> None:
    """Write the draws, exact to the last bit and compressed, whole or not at all."""
    content = BytesIO()  # the HDF5 library ends the process where a disk is full
    for number, (group, dataset) in enumerate(datasets(posterior).items()):
        packed = {name: {"zlib": True, "complevel": 4, "shuffle": True} for name in dataset.data_vars}
        write_dataset(dataset, content, mode="a" if number else "w", group=group, encoding=packed)
    with whole_file(path) as draft:
        draft.write_bytes(content.getbuffer())
        seal(draft)


def load_posterior(path: str | os.PathLike[str], fit: FitResult) -> Posterior:
    """Read draws written by :meth:`Posterior.save`.

    Args:
        path: the netCDF file.
        fit: the fit that was sampled.

    Raises:
        FileNotFoundError: no such file.
        ValueError: not such a file, or the posterior of another fit.

    Example:
        >>> posterior = rf.sample(fit, seed=1, walkers=32, ess=100)
        >>> posterior.save(folder / "posterior.nc")
        >>> again = rf.load_posterior(folder / "posterior.nc", fit)
        >>> again.interval("lam") == posterior.interval("lam")
        True
    """
    path = Path(path)
    note_input(path)
    kind = "posterior saved by rotorfit"
    with reading(path.name, kind, decoded=True):
        posterior = _read(path, fit)
    with reading(path.name, kind):
        _check(posterior, path.name)
    return posterior


def _read(path: Path, fit: FitResult) -> Posterior:
    draws, stats = (load_dataset(path, group) for group in ("posterior", "sample_stats"))
    header = draws.attrs
    if header.get("title") != _KIND:
        raise ValueError(f"{path.name} was not written by rotorfit's Posterior.save")
    variables = sorted(draws.data_vars.values(), key=lambda v: int(v.attrs["position"]))
    return Posterior(
        fit=fit,
        names=tuple(str(v.attrs["parameter"]) for v in variables),
        chain=np.stack([_numbers(v).T for v in variables], axis=-1),
        log_density=np.ascontiguousarray(_numbers(stats["lp"]).T),
        acceptance=_numbers(stats["acceptance_rate"]),
        tau=np.array([float(v.attrs["autocorrelation_time"]) for v in variables]),
        burn_in=int(header["burn_in"]),
        converged=bool(header["converged"]),
        message=str(header["message"]),
        treatment=str(header["treatment"]),
        seed=int(header["seed"]),
        settings=SampleSettings(**json.loads(header["settings"])),
        sizes=np.ascontiguousarray(_numbers(stats["causes"]).swapaxes(0, 1)) if "causes" in stats else None,
    )


def _numbers(variable: Any) -> Float:
    """Values of a variable, refused where they are text."""
    if variable.dtype.kind not in "fiu":
        raise TypeError(f"{variable.name} is not of numbers")
    return np.asarray(variable.values, dtype=float)


def _check(posterior: Posterior, source: str) -> None:
    """The density of the last draws, evaluated anew, tells whether data, model and priors are those of the fit."""
    fit = posterior.fit
    target = posterior_of(fit, posterior.settings)
    if target.names != posterior.names:
        raise ValueError(
            f"{source} holds {', '.join(posterior.names)}, but this fit is of {', '.join(target.names)}: load it with "
            "the fit that was sampled"
        )
    last = posterior.chain[-1]
    if isinstance(target, CausedPosterior) and posterior.sizes is not None:
        last = target.alone(last, posterior.sizes[-1])
    if not np.allclose(target(last), posterior.log_density[-1], rtol=1e-8, atol=1e-6):
        raise ValueError(f"{source} is the posterior of another fit: data, model, priors or noise differ")


def load_arviz() -> Any:
    """The module ``arviz``, imported now if it has not been.

    The announcement is for those who write against ArviZ, not for those who fit rotors; which day a machine last saw it
    must not decide what a user or a test sees. It keeps that day in the folder for caches.
    """
    cache_home()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing", category=FutureWarning)
        import arviz
    return arviz
