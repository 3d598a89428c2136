"""The list of causes that a rig may have beside its model, each with a size, its reason and its source."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.set_speeds import once_per_turn
from rotorfit.estimators.inference.cause_acts import (
    Act,
    Changing,
    Drifting,
    Film,
    Flexible,
    Hysteresis,
    Known,
    Lag,
    Motion,
    OfClearance,
    OffPlane,
    OfReadings,
    Resting,
    SpeedLabel,
    Term,
)
from rotorfit.estimators.inference.causes import Cause
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.causes.calibration import Calibration, sizes_of
from rotorfit.identify.fitting.causes.sizes import SIZES, Size
from rotorfit.models import RotorModel
from rotorfit.models.motion.neglected_terms import LeftOut, dampings, fluid_coordinates, fluid_endings, terms_left_out

_FLUID = {"lam": ("lam", "lam_D", "lam_M"), "K0": ("K0",), "D": ("D",)}
_OF_FLUID = ("K0", "D", "lam", "lam_D", "lam_M", "Mf")


def listed(
    problem: Problem,
    x: Float,
    given: Mapping[str, float],
    calibration: Calibration | None = None,
    *,
    of_another: bool = False,
) -> tuple[Cause, ...]:
    """Causes of a problem at fitted values, those that were given with their sizes; none without a size. Of sizes that
    were given for another test, those of causes that this one cannot have do not count.

    Raises:
        KeyError: a name that is not in the list; the message names the nearest.
        ValueError: a size that is negative or no number.
    """
    if not problem.space.model.has_causes:
        return ()
    rig = _Rig.of(problem, x, frozenset(given))
    found = list(rig.causes())
    if calibration is not None:
        sizes = sizes_of(calibration, rig.probes)
        if len(rig.probes) == 1 and (own := sizes.pop(f"gain[{next(iter(rig.probes))}]", 0.0)):
            sizes["gain"] = math.hypot(sizes["gain"], own)  # one plane has no gain beside the common one
        given = {**sizes, **given}
    names = [cause.name for cause in found]
    for name, size in given.items():
        if name not in names and of_another:
            continue
        if name not in names:
            raise KeyError(unknown_name("cause", name, names))
        if not 0 <= size < math.inf:
            raise ValueError(f"the size of the cause {name} is {size}; it is positive, or zero for none")
    sized = (replace(c, size=given[c.name], reason="given") if c.name in given else c for c in found)
    return tuple(cause for cause in sized if cause.size > 0 and math.isfinite(cause.size))


def _of_fluid(model: RotorModel) -> set[str]:
    """Names of the parameters of the fluids' forces."""
    return {name + ending for name in _OF_FLUID for ending in fluid_endings(model)}


def probe_factors(model: RotorModel) -> dict[str, str]:
    """Names of the factors of probes that a model can have, by the plane that is read."""
    names = {plane: f"beta{number}" for number, plane in enumerate(model.read_planes, 1)}
    possible = "betas" in model.options()
    return {plane: name for plane, name in names.items() if possible or name in model.parameter_names}


@dataclass(frozen=True, eq=False, kw_only=True)
class _Rig:
    """What the sizes of causes are measured by."""

    problem: Problem
    model: RotorModel
    thetas: Float
    blocks: tuple[Responses, ...]  # all that hold responses to forces
    circular: tuple[Responses, ...]  # those to circular forces
    fitted: frozenset[str]  # names of the model's parameters that are fitted
    stiffness: Float  # of the shaft at each coordinate, N/m
    inertia: Float  # likewise, kg
    top: float  # highest frequency, rad/s
    given: frozenset[str]  # names of causes whose size was given

    @classmethod
    def of(cls, problem: Problem, x: Float, given: frozenset[str]) -> _Rig:
        """Measure a problem."""
        thetas, model = problem.space.theta(x), problem.space.model
        blocks = tuple(problem.responses)
        motions = (Motion(block=block, theta=thetas) for block in problem.blocks)
        circular = tuple(motion.circular for motion in motions if motion.circular is not None)
        top = max((float(np.abs(b.frequency).max()) for b in blocks), default=0.0)
        stiffness, inertia = _shaft(model, thetas[0], top) if circular else (np.zeros(0), np.zeros(0))
        return cls(
            problem=problem,
            model=model,
            thetas=thetas,
            blocks=blocks,
            circular=circular,
            fitted=frozenset(problem.space.base),
            stiffness=stiffness,
            inertia=inertia,
            top=top,
            given=given,
        )

    @cached_property
    def probes(self) -> dict[str, tuple[str, ...]]:
        """Directions of the probes of each plane that is read; a response without one is the mean of x and y."""
        found: dict[str, dict[str, None]] = {}
        for block in self.blocks:
            for k in np.unique(block.coordinate).tolist():
                place = self.model.coordinates[k]
                names = [str(block.labels[i]) for i in np.unique(block.label[block.coordinate == k])]
                pair = place.axis == "z" and not any(name.endswith((" x", " y")) for name in names)
                found.setdefault(place.plane, {}).update(dict.fromkeys("xy" if pair else place.axis))
        return {plane: tuple(axes) for plane, axes in found.items()}

    @cached_property
    def _sweep(self) -> tuple[float, float]:
        """Middle and half width of the frequencies that turn, rad/s."""
        w = np.abs(np.concatenate([b.frequency for b in self.blocks]))
        w = w[w > 0]
        return (float(w.max() + w.min()) / 2, float(w.max() - w.min()) / 2) if w.size else (0.0, 0.0)

    @cached_property
    def turning(self) -> bool:
        """True for rotors in z = x + jy, whose causes act on the rotor too. Loads and off-centre motion of a rotor with
        a law have no columns of those: beside them the orbits would tell what both hold."""
        alone = not self.model.eccentricity_dependent or len(self.problem.blocks) == len(self.circular) + sum(
            block.speed_read is not None for block in self.problem.blocks
        )
        return (
            self.model.frame == "z"
            and all(c.axis == "z" for c in self.model.coordinates)
            and bool(self.circular)
            and alone
        )

    def causes(self) -> Iterator[Cause]:
        """All causes that these tests and this model may have."""
        yield from self._known()
        if self.blocks:
            yield from self._readings()
        if self.turning:
            yield from self._dampers()
            yield from self._shaft_losses()
            yield from self._between()
            yield from self._fluid()
            yield from self._places()
            yield from self._beyond()
        elif self.model.eccentricity_dependent and self.model.frame == "z" and self.blocks:
            yield from self._fluid()

    # ---- values taken as known -------------------------------------------------------------------------------------

    def _known(self) -> Iterator[Cause]:
        """Values that were taken as known, and the clearance where motion was divided by it."""
        held = np.asarray((self.problem.space.index < 0).all(axis=0))
        for place, parameter in enumerate(self.model.parameters):
            value = float(self.thetas[0, place])
            if not held[place] or not value or parameter.name.startswith("beta") or self._is_damper(parameter.name):
                continue
            usual = SIZES["mass" if parameter.unit == "kg" else "damping" if parameter.unit == "N s/m" else "known"]
            yield _cause(
                parameter.name,
                f"{parameter.meaning}, taken as known",
                Known(name=parameter.name),
                usual,
                times=abs(value),
                unit=parameter.unit,
            )
        divided = any(block.over_clearance for block in self.problem.blocks)
        if divided and self.model.clearance:
            yield _cause("clearance", "radial clearance, a share of it", OfClearance(), SIZES["clearance"])

    def _is_damper(self, name: str) -> bool:
        """True for a known damping at a plane that an external damper there stands for, unless its error is given."""
        return self.turning and name not in self.given and any(name in own for own in self._damping.values())

    @cached_property
    def _damping(self) -> dict[int, tuple[str, ...]]:
        """Names of the external dampings at each coordinate."""
        model = self.model
        blocks = {p.name for p in model.parameters if p.name[:1] in "gc" and p.unit in ("kg", "N s/m")}
        others = blocks | _of_fluid(model) | {p.name for p in model.parameters if p.unit != "N s/m"}
        at = {row: tuple(name for name in names if name not in others) for row, names in dampings(model).items()}
        return {row: names for row, names in at.items() if names}

    # ---- readings --------------------------------------------------------------------------------------------------

    def _readings(self) -> Iterator[Cause]:
        """Probes, forces, and the phase reference."""
        planes = list(
            dict.fromkeys(self.model.coordinates[k].plane for b in self.blocks for k in np.unique(b.coordinate))
        )
        moving = any(b.frequency.any() for b in self.blocks)
        whole = SIZES["gain"]
        single = len(planes) == 1
        if single:
            size = math.hypot(whole.size, SIZES["gain[plane]"].size)
            whole = replace(whole, size=size, reason=f"{whole.reason}; the probes' chain 2 %")
        yield _cause("gain", "gain of all readings over all forces", OfReadings(how="gain"), whole)
        for plane in planes if not single else ():
            if not self._free_probe(plane):
                act = OfReadings(how="gain", plane=plane)
                one = _cause(f"gain[{plane}]", f"gain of the probes at {plane}", act, SIZES["gain[plane]"])
                yield replace(one, parameter=self._factors.get(plane, ""))
        yield _cause(
            "turned",
            "angle of the probes, from the zero of the force",
            OfReadings(how="turned"),
            SIZES["turned"],
            unit="rad",
        )
        if not moving:
            return
        yield _cause("phase", "lead of the phase reference", OfReadings(how="phase"), SIZES["phase"], unit="rad")
        yield _cause("delay", "delay of readings behind forces", OfReadings(how="delay"), SIZES["delay"], unit="s")
        act = OfReadings(how="high-pass")
        meaning = "corner of a high-pass of first order that all readings are behind"
        yield _cause("high-pass", meaning, act, SIZES["high-pass"], unit="rad/s", positive=True)
        middle, half = self._sweep
        if half > 0:
            act = OfReadings(how="clock", middle=middle, half=half)
            meaning = "delay that grows from the middle of a sweep to its end"
            yield _cause("clock", meaning, act, SIZES["clock"], unit="s")
        for plane in planes:
            act = OfReadings(how="curve", plane=plane)
            meaning = f"probes at {plane} that are not linear, share at the largest amplitude"
            usual = SIZES["curve[probe]" if self.model.clearance else "curve"]  # the film by its own cause, or a law
            yield _cause(f"curve[{plane}]", meaning, act, usual)
            act = OfReadings(how="phase", plane=plane)
            yield _cause(f"lead[{plane}]", f"lead of the probes at {plane}", act, SIZES["lead"], unit="rad")

    @cached_property
    def _factors(self) -> dict[str, str]:
        """See :func:`probe_factors`."""
        return probe_factors(self.model)

    def _free_probe(self, plane: str) -> bool:
        """True if the factor of the probe of a plane is fitted."""
        return self._factors.get(plane, "") in self.fitted

    # ---- the rotor -------------------------------------------------------------------------------------------------

    def _dampers(self) -> Iterator[Cause]:
        """An external damper at each plane whose damping is not fitted."""
        size, planes = SIZES["damper"], len(self.model.planes)
        damping = self._damping
        for at, coordinate in enumerate(self.model.coordinates):
            names = damping.get(at, ())
            if (self.fitted | self.given) & set(names):
                continue
            usual = size.size / math.sqrt(planes) * math.sqrt(self.stiffness[at] * self.inertia[at])
            known = sum(abs(float(self.thetas[0, self.model.parameter_names.index(name)])) for name in names)
            one = replace(size, size=max(usual, SIZES["damping"].size * known))
            neglected = self._beside_fluid(at) - known if names else 0.0
            if neglected > one.size:
                one = replace(SIZES["neglected"], size=neglected)
            term = LeftOut("", "", "", ((at, at, 1.0),), ((1.0, 1, 0),))
            meaning = f"external damper at {coordinate.plane}, beside what is known there"
            yield _cause(f"damper[{coordinate.plane}]", meaning, Term(left_out=term), one, unit="N s/m", positive=True)

    def _beside_fluid(self, at: int) -> float:
        """Damping at a coordinate that is neglected beside that of a fluid there; none without one."""
        if at not in fluid_coordinates(self.model):
            return 0.0
        plane, names = self.model.coordinates[at].plane, self.model.parameter_names
        ending = next((fluid.ending for fluid in self.model.fluids if fluid.plane == plane), "")
        return SIZES["neglected"].size * abs(float(self.thetas[0, names.index(f"D{ending}")]))

    def _shaft_losses(self) -> Iterator[Cause]:
        """Damping inside the shaft, hysteresis, and gyroscopic effects of disks, at each plane."""
        loss, gyro = SIZES["loss"], SIZES["gyro"]
        blocks = getattr(self.model, "blocks", ())
        for at, coordinate in enumerate(self.model.coordinates):
            own, plane = ((at, at, 1.0),), coordinate.plane
            K, M = self.stiffness[at], self.inertia[at]
            if "internal_damping" not in blocks and at == 0:
                term = LeftOut("", "", "", own, ((1.0, 1, 0), (-1j, 0, 1)))
                meaning = "damping inside the shaft, which turns with it"
                times = math.sqrt(K * M)
                yield _cause("loss", meaning, Term(left_out=term), loss, times=times, unit="N s/m", positive=True)
            meaning = f"damping at {plane} that does not grow with frequency"
            act = Hysteresis(entries=own)
            yield _cause(f"hysteresis[{plane}]", meaning, act, loss, times=K, unit="N/m", positive=True)
            if "gyroscopic" not in blocks:
                term = LeftOut("", "", "", own, ((-1j, 1, 1),))
                meaning = f"gyroscopic effect of a disk at {plane}"
                yield _cause(f"gyro[{plane}]", meaning, Term(left_out=term), gyro, times=M, unit="kg", positive=True)

    def _between(self) -> Iterator[Cause]:
        """Passive coupling between neighbours, and modes above the band, where the model has no block of it."""
        if len(self.model.planes) < 2:
            return
        stiffness = float(np.median(self.stiffness))
        speed = max((float(b.speed.max()) for b in self.circular), default=0.0) or self.top
        words = {"c": "damper", "g": "gyro"}
        for term in terms_left_out(self.model):
            symbol, _, where = term.name.partition("[")
            _, power, speeds = term.terms[0]
            planes = where.rstrip("]")
            if symbol == "m":
                usual, (i, j, _), *_ = SIZES["mass between"], *term.entries
                times = math.sqrt(self.inertia[i] * self.inertia[j])
                meaning = f"{term.meaning}, {planes}"
                yield _cause(f"mass[{planes}]", meaning, Term(left_out=term), usual, times=times, unit="kg")
            elif symbol in words and "," in planes:
                times = stiffness / self.top**power / speed**speeds
                yield _cause(
                    f"{words[symbol]}[{planes}]", f"{term.meaning}, {planes}", Term(left_out=term), SIZES["between"],
                    times=times, unit=term.unit,
                )  # fmt: skip
            elif symbol == "q" and "," not in planes:
                at = term.entries[0][0]
                times = self.stiffness[at] / self.top**4
                yield _cause(
                    term.name, f"{term.meaning}, {planes}", Term(left_out=term), SIZES["q"], times=times, unit=term.unit
                )

    # ---- the fluid -------------------------------------------------------------------------------------------------

    def _fluid(self) -> Iterator[Cause]:
        """Values of the fluid that change with speed and along a sweep, speeds that are off, and a force that lags."""
        model, names = self.model, set(self.model.parameter_names)
        seats = fluid_coordinates(model)
        tests = self.circular if self.turning else self.blocks
        speeds = np.unique(np.abs(np.concatenate([b.set_speed for b in tests])))
        start_ups = all(once_per_turn(b.frequency, b.speed).all() for b in tests)
        if model.speed_dependent and speeds.any() and not start_ups:
            # Of labels all lines of a run have one; what differs from line to line was counted.
            counted = not any(np.array_equal(b.speed, b.set_speed) or _labelled(b) for b in tests)
            usual = SIZES["speed label[counted]" if counted else "speed label"]
            yield _cause("speed label", "share by which all speeds are off", SpeedLabel(), usual)
        if not seats:
            return
        one_value = self.problem.space.index.shape[0] == 1 or (
            self.problem.space.index == self.problem.space.index[0]
        ).all(axis=0)
        mean = float(speeds.mean())
        for ending in fluid_endings(model):
            yield from self._of_one_fluid(ending, names, one_value, mean)

    def _of_one_fluid(self, ending: str, names: set[str], one_value: Bool | bool, mean: float) -> Iterator[Cause]:
        """Changes of one of the fluids."""
        model, seats = self.model, fluid_coordinates(self.model)
        here = [self.model.coordinate(fluid.plane, "z") for fluid in model.fluids if fluid.ending == ending] or seats
        for name, group in _FLUID.items():
            own = tuple(n + ending for n in group if n + ending in names)
            single = all(
                np.broadcast_to(one_value, len(model.parameter_names))[model.parameter_names.index(n)] for n in own
            )
            if own and mean and single and f"{name}_speed{ending}" not in names:
                act = Changing(names=own, mean=mean)
                meaning = f"share by which {name}{ending} changes when the mean tested speed doubles"
                yield _cause(f"speed[{name}{ending}]", meaning, act, SIZES[f"speed[{name}]"])
        middle, half = self._sweep
        where = f"[{ending[1:]}]" if ending else ""
        if half > 0:
            drifting = Drifting(name=f"D{ending}", middle=middle, half=half)
            meaning = f"share by which D{ending} changes from the middle of a sweep to its end"
            yield _cause(f"drift{where}", meaning, drifting, SIZES["drift"])
        if len(here) == 1:
            plane, D = model.coordinates[here[0]].plane, f"D{ending}"
            clearance = model.clearance_at(plane)
            if clearance and not model.eccentricity_dependent:
                act_film = Film(name=D, at=here[0], clearance=clearance)
                meaning = f"growth of {D} by the square of the orbit over the clearance"
                yield _cause(f"film{where}", meaning, act_film, SIZES["film"], positive=True)
            meaning = (
                f"square of the eccentricity at which the journal rests at {plane}, {D} being that of a centred one"
            )
            rest = Resting(name=D, times=3.0)  # of a short bearing
            yield _cause(f"rest[{plane}]", meaning, rest, SIZES["rest"], positive=True)
        has_ratio = {f"lam{ending}", f"lam_D{ending}"} & names
        lags = {f"D{ending}", f"Mf{ending}"} <= names and has_ratio and f"Mf{ending}" in self.fitted
        if lags and self.circular and not model.eccentricity_dependent:  # whose damping is not D alone
            act_lag = Lag(entries=tuple((at, at, 1.0) for at in here), ending=ending)
            meaning = f"time by which the fluid's damping force lags, which Mf{ending} takes up"
            yield _cause(f"lag{where}", meaning, act_lag, SIZES["lag"], times=1 / self.top, unit="s", positive=True)

    # ---- places ----------------------------------------------------------------------------------------------------

    def _places(self) -> Iterator[Cause]:
        """Probes and forces that are not at their planes."""
        planes, size = [c.plane for c in self.model.coordinates], len(self.model.planes)
        if size < 2:
            return
        read = {int(k) for b in self.circular for k in np.unique(b.coordinate)}
        for what, places in (("probe", read), ("force", self._driven)):
            for at in sorted(place for place in places if place < size):
                towards = at + 1 if at + 1 < size else at - 1
                act = OffPlane(what=what, at=at, towards=towards)
                meaning = f"{what} at {planes[at]} off its plane, share of the way to {planes[towards]}"
                yield _cause(f"{what}[{planes[at]}]", meaning, act, SIZES["offset"])

    @cached_property
    def _driven(self) -> set[int]:
        return {int(k) for b in self.circular for k in np.flatnonzero(b.force.any(axis=0))}

    def _beyond(self) -> Iterator[Cause]:
        """Motion at the force's own plane by modes above the band."""
        speed = float(np.mean(np.concatenate([b.speed for b in self.circular])))
        low = 1e-3 * self.top
        H = self.model.receptance(self.thetas[0], np.array([low]), speed)[0]
        seats = fluid_coordinates(self.model)
        for at in sorted(self._driven):
            plane = self.model.coordinates[at].plane
            usual = SIZES["flex[journal]" if at in seats and len(self.model.planes) > 1 else "flex"]
            meaning = f"motion at {plane} in step with a force there, by modes above the band"
            yield _cause(
                f"flex[{plane}]",
                meaning,
                Flexible(at=at),
                usual,
                times=float(abs(H[at, at])),
                unit="m/N",
                positive=True,
            )


def _labelled(block: Responses) -> bool:
    """True where each run has one speed, which another run of the same set speed may have missed by a little."""
    runs, run = np.unique(block.run, return_inverse=True)
    return len(np.unique(np.column_stack([run.reshape(-1), block.speed[block.line]]), axis=0)) == runs.size


def _cause(
    name: str, meaning: str, act: Act, usual: Size, *, times: float = 1.0, unit: str = "1", positive: bool = False
) -> Cause:
    """A cause with its usual size times a quantity of the fit."""
    return Cause(
        name=name,
        meaning=meaning,
        unit=unit,
        size=float(usual.size * times),
        act=act,
        one_sided=positive,
        reason=usual.reason,
        source=usual.source,
        remedy=usual.remedy,
    )


def _shaft(model: RotorModel, theta: Float, top: float) -> tuple[Float, Float]:
    """Stiffness and inertia of the rotor without its fluid, or with it where it has none, at each coordinate."""
    alone = np.where([name in _of_fluid(model) for name in model.parameter_names], 0.0, theta)
    found = []
    for vector in (alone, theta):
        still, moving = (
            np.diagonal(model.dynamic_stiffness(vector, np.array([w]), 0.0)[0]).real for w in (1e-6 * top, 0.3 * top)
        )
        found.append((still, (still - moving) / (0.3 * top) ** 2))
    (K, M), (all_K, all_M) = found
    stiffness = np.where(1e-9 * np.abs(all_K) < K, K, np.abs(all_K))
    inertia = np.where(1e-9 * np.abs(all_M) < M, M, np.abs(all_M))
    return stiffness, inertia
