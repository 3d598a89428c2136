"""Does `rotorfit watch` keep the false-alarm rate that was asked for, and how soon does it find a change?

Histories of one machine, with the rules of the watch asked after every test. Beside them stand what is usual, a test
beyond three standard deviations of the first ten, and a t test at the same rate after every test of the later half
against the earlier one. Values scatter normally, or with the tails of Student's t with three degrees of freedom, or
skewed; or they are fits: tests of a one-mode rotor with 1 % noise and weights mounted anew within 2 %, of which
histories of three values (K0, lam, D) are drawn. At the limit: a threshold speed that is exactly what is required,
with errors half of which all tests have in common. Two rows show what the rules take for granted: scatter that hangs
together from test to test, and errors of the threshold that are a third of its scatter, with none in common.

    python benchmarks/watch_alarms.py [--histories 400] [--tests 100]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from reporting import environment, table
from scipy.signal import lfilter
from scipy.stats import t

import rotorfit as rf
from rotorfit.studies.monitoring.alarms import WatchedValues, watch_rules

Values = NDArray[np.float64]
RATES = (0.05, 0.01)
BEFORE = 20
"""Tests before a change."""
SHIFTS = (2.0, 3.0, 5.0, 10.0, 60.0)
POOL = 240
"""Fits that histories are drawn from."""
TRUTH = {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4}


def watched(values: Values, stderr: float = 1.0, systematic: float = 0.0, name: str = "D") -> WatchedValues:
    """Values as the watch has them."""
    each = np.ones(len(values))
    return WatchedValues(
        name=name,
        unit="1",
        tests=tuple(range(1, len(values) + 1)),
        value=values,
        stderr=stderr * each,
        systematic=systematic * each,
    )


def three_sigma(values: Values) -> bool:
    """One test beyond three standard deviations of the first ten."""
    first = values[:10]
    return bool(np.any(np.abs(values[10:] - first.mean()) > 3 * first.std(ddof=1)))


def repeated_t_test(values: Values, rate: float) -> bool:
    """The later half against the earlier one, at a fixed level after every test from the eighth on."""
    n = np.arange(8, len(values) + 1)
    first, last = n // 2, n - n // 2
    sums, squares = (np.concatenate([[0.0], np.cumsum(values**power)]) for power in (1, 2))
    mean_first, mean_last = sums[first] / first, (sums[n] - sums[first]) / last
    rest = squares[n] - first * mean_first**2 - last * mean_last**2
    statistic = (mean_last - mean_first) / np.sqrt(rest / (n - 2) * (1 / first + 1 / last))
    return bool(np.any(2 * t.sf(np.abs(statistic), n - 2) < rate))


def scatter(random: np.random.Generator) -> dict[str, Callable[[int], Values]]:
    """Kinds of scatter, each of standard deviation about one."""
    return {
        "normal": lambda n: random.normal(size=n),
        "Student's t, 3 degrees of freedom": lambda n: random.standard_t(3, size=n),
        "lognormal": lambda n: random.lognormal(0, 0.5, size=n),
        "correlated by 0.3 from test to test": lambda n: correlated(random.normal(size=n), 0.3),
        "correlated by 0.6 from test to test": lambda n: correlated(random.normal(size=n), 0.6),
    }


def correlated(steps: Values, share: float) -> Values:
    """Values each of which keeps a share of the one before."""
    return np.asarray(lfilter([np.sqrt(1 - share**2)], [1.0, -share], steps))


def fitted_pool(random: np.random.Generator) -> Values:
    """K0, lam and D of fits of one machine, shape ``(POOL, 3)``."""
    model = rf.models.OneMode()
    theta = np.array([TRUTH[name] for name in model.parameter_names])
    frequency = np.concatenate([np.linspace(-200, -20, 12), np.linspace(20, 200, 12)])
    speed, weight = np.repeat([100.0, 180.0], frequency.size), 1e-4
    frequency = np.tile(frequency, 2)
    force = weight * frequency**2
    exact = model.receptance(theta, frequency, speed)[:, 0, 0] * force
    rows = []
    for number in range(POOL):
        mounted = 1 + 0.02 * (random.normal() + 1j * random.normal())
        noise = random.normal(size=exact.size) + 1j * random.normal(size=exact.size)
        level = 0.01 * np.sqrt(np.mean(np.abs(exact) ** 2))
        test = rf.perturbation_test(
            run=[f"{s:g} {np.sign(w):+g}" for s, w in zip(speed, frequency, strict=True)],
            speed=speed,
            frequency=frequency,
            force_plane="journal",
            force=force,
            plane="journal",
            direction="z",
            response=exact * mounted + level * noise,
            sigma=level,
            source=f"test {number}",
        )
        fit = rf.fit(model, test, known={"K": TRUTH["K"], "Ds": TRUTH["Ds"]})
        rows.append([fit.params[name].value for name in ("K0", "lam", "D")])
    return np.array(rows)


def shares(histories: int, draw: Callable[[], list[Values]], rate: float) -> list[str]:
    """Shares of histories with an alarm by the watch, by three standard deviations, and by repeated t tests."""
    counts = np.zeros(3)
    for _ in range(histories):
        values = draw()
        rules = watch_rules([watched(one, name=str(i)) for i, one in enumerate(values)], rate)
        counts[0] += any(rule.alarm is not None for rule in rules)
        counts[1] += any(map(three_sigma, values))
        counts[2] += any(repeated_t_test(one, rate / len(values)) for one in values)
    return [f"{count / histories:.4f}" for count in counts]


def at_the_limit(
    histories: int, tests: int, rate: float, random: np.random.Generator, scatter: float = 1.0, common: float = 1.0
) -> str:
    """Share of histories with an alarm where the threshold speed is what is required, its standard error 1."""
    alarms = 0
    for _ in range(histories):
        values = 300 + common * random.normal() + scatter * random.normal(size=tests)
        rules = watch_rules([], rate, margin=(watched(values, 1.0, common), 300.0))
        alarms += rules[0].alarm is not None
    return f"{alarms / histories:.4f}"


def delays(histories: int, shift: float, rate: float, random: np.random.Generator) -> list[str]:
    """Tests after a change until the alarm: 10 %, median, 90 %; 40 stands for none."""
    waits = []
    for _ in range(histories):
        values = random.normal(size=BEFORE + 40)
        values[BEFORE:] += shift
        alarm = watch_rules([watched(values)], rate)[0].alarm
        waits.append(40 if alarm is None else max(alarm - BEFORE, 0))
    return [f"{one:.0f}" for one in np.percentile(waits, [10, 50, 90])]


def main() -> None:
    """Print the tables and keep them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--histories", type=int, default=400)
    parser.add_argument("--tests", type=int, default=100)
    options = parser.parse_args()
    random, count, tests = np.random.default_rng(1), options.histories, options.tests
    pool = fitted_pool(random)
    rows = []
    for rate in RATES:
        for name, draw in scatter(random).items():
            rows.append([name, f"{rate:g}", *shares(count, lambda draw=draw: [draw(tests)], rate)])
        drawn = shares(count, lambda: list(random.permutation(pool)[:tests].T), rate)
        rows.append(["K0, lam, D of fits, together", f"{rate:g}", *drawn])
        kept = [at_the_limit(count, tests, rate, random, *sizes) for sizes in ((), (3.0, 1.0), (3.0, 0.0))]
        for name, share in zip(
            ("", ", scatter of 3 errors", ", scatter of 3 errors, none in common"), kept, strict=True
        ):
            rows.append([f"threshold speed at its limit{name}", f"{rate:g}", share, "", ""])
    found = [[f"{shift:g}", *delays(count // 4, shift, 0.01, random)] for shift in SHIFTS]
    lines = [
        "# Alarms of a watched machine",
        "",
        f"Made by `python benchmarks/watch_alarms.py --histories {count} --tests {tests}` on "
        f"{environment('numpy', 'scipy')}.",
        "",
        f"Share of {count} histories of {tests} tests without a change in which an alarm was ever raised:",
        "",
        *table(["scatter", "asked for", "watch", "3 standard deviations", "t test after every test"], rows),
        "",
        f"Tests from a change after {BEFORE} on until the alarm, at a false-alarm rate of 0.01 (40: none within 40), "
        f"{count // 4} histories:",
        "",
        *table(["change in standard deviations of one test", "10 %", "median", "90 %"], found),
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parent / "results" / "watch_alarms.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
