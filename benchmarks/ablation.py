"""What each rung of inference is for: posteriors fitted with everything, and with one rung switched off at a time.

`python benchmarks/ablation.py --out benchmarks/ablation/rungs.csv`; `--posteriors` and `--rungs` do a part by parts of
names, `--tabulate FILE` prints the table of one that was written. What a table has is not computed again.

Changes are from a reference: everything on, four times the draws, another seed. A rung is not run again where it gave
back what it was given, or was not called. Checks that change no draw are judged by what they say of all wrong answers,
theirs or those of other rungs.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.extend(
    str(Path(__file__).parents[1] / one) for one in (".", "benchmarks/ablation", "tests", "tests/inference")
)
from posteriors import Subject, list_posteriors
from rungs import RUNGS, Rung, Watch, patched

from bayescal.errors import NumericalError
from bayescal.experiments.shared import estimate
from bayescal.inference.schema import SHORT, USUAL, EvidenceConfig, SamplerConfig
from bayescal.inference.tempered import estimate_by_tempering
from bayescal.limits import TEMPERED_LIMIT
from bayescal.numerics.geometry import Array

QUANTILES = (0.05, 0.5, 0.95)
EFFORT = EvidenceConfig(max_draws=32_000)
MORE = EvidenceConfig(draws=16_000, max_draws=128_000, tolerance_nat=0.005)
MORE_STEPS = 4
SEED, OTHER_SEED = 1, 2
LEAST_ERROR = 0.01  # nats, of an evidence
ALL, REFERENCE, TEMPERED = "(all on)", "(reference)", "(tempering)"
WRONG_NATS, WRONG_ERRORS, WRONG_SD = 0.1, 4.0, 0.25
"""An answer is wrong where its log-evidence is off by more nats than evidences may differ, and more standard errors; or
a quantile by more posterior sds, and `ABOVE_CHANCE` times what everything on is off."""
ABOVE_CHANCE = 2.0
WRONG_ELPD = 1.0  # nats of all rows left out, beside what everything on says
SLOWER = 1.25  # CPU seconds over those of everything on that are no chance
CHECKS = (
    *("R-hat", "bulk ESS", "tail ESS", "mode search", "bridge sampling", "log-evidences differ", "Pareto k"),
    *("effective importance draws", "stuck walker", "in tails", "exact density"),
)
"""Words by which problems are known."""


@dataclass(frozen=True, eq=False)
class Found:
    """A fit, quantiles (3, n) and standard deviations (n,) of all its draws in sampling coordinates, CPU seconds."""

    fit: estimate.Estimate
    quantiles: Array
    sd: Array
    seconds: float

    @property
    def elpd(self) -> float:
        """Log predictive density of rows left out; NaN of a density alone."""
        left_out = getattr(self.fit, "left_out", None)
        return np.nan if left_out is None else float(left_out.elpd.sum())


@contextmanager
def recording(draws: list[Array]) -> Iterator[None]:
    """Keep all draws, of which an estimate has some."""
    find = estimate.find_solutions

    def record(y: Array, *rest: Any) -> Any:
        draws.append(y.reshape(-1, y.shape[-1]))
        return find(y, *rest)

    with patched({(estimate, "find_solutions"): record}):
        yield


def fit(subject: Subject, seed: int, sampler: SamplerConfig, effort: EvidenceConfig) -> Found:
    """Return what is found of a posterior."""
    draws: list[Array] = []
    began = time.process_time()
    with recording(draws):
        if subject.readings is None:
            found = estimate.estimate_posterior(subject.density, seed, "ablation", sampler, effort)
        else:
            found = estimate.fit_posterior(subject.readings, seed, "ablation", sampler, effort)
    seconds = time.process_time() - began
    return Found(found, np.quantile(draws[0], QUANTILES, axis=0), draws[0].std(axis=0), seconds)


def compare(found: Found, reference: Found) -> dict[str, float]:
    """Return changes of evidence, in nats and standard errors, of the worst quantile in sds, and of elpd."""
    error = max(np.hypot(found.fit.log_evidence_se, reference.fit.log_evidence_se), LEAST_ERROR)
    change = found.fit.log_evidence - reference.fit.log_evidence
    apart = np.abs(found.quantiles - reference.quantiles) / np.where(reference.sd > 0.0, reference.sd, 1.0)
    return {
        "evidence_nat": round(float(change), 4),
        "evidence_se": round(float(abs(change) / error), 2),
        "quantile_sd": round(float(apart.max()), 3),
        "elpd_nat": round(found.elpd - reference.elpd, 3),
    }


def describe(found: Found) -> dict[str, object]:
    """Return what a fit says of itself."""
    one = found.fit
    return {
        "log_evidence": round(one.log_evidence, 4),
        "log_evidence_se": round(one.log_evidence_se, 4),
        "efficiency": round(one.importance.efficiency, 3),
        "pareto_k": round(one.importance.pareto_k, 2),
        "steps": one.n_steps,
        "modes": len(one.modes),
        "cpu_s": round(found.seconds, 2),
        "problems": "; ".join(one.list_problems()),
    }


def ablate(name: str, subject: Subject, rungs: list[Rung]) -> Iterator[dict[str, object]]:
    """Yield the rows of one posterior: everything on, the reference, each rung off."""
    watch, sampler = Watch(), SamplerConfig()
    with watch.watching(RUNGS):
        base = fit(subject, SEED, sampler, EFFORT)
    more = sampler.model_copy(update={"steps": MORE_STEPS * base.fit.n_steps, "burn_in": USUAL[0]})
    reference = fit(subject, OTHER_SEED, more, MORE)
    yield {"posterior": name, "rung": REFERENCE, "reached": True, **describe(reference)}
    own = {**describe(base), **compare(base, reference)}
    yield {"posterior": name, "rung": ALL, "reached": True, "cpu_ratio": 1.0, **own}
    if subject.tempered:
        began = time.process_time()
        told = estimate_by_tempering(subject.density, np.random.SeedSequence(SEED), 512, 4)
        yield {
            **{"posterior": name, "rung": TEMPERED, "reached": True, "cpu_s": round(time.process_time() - began, 2)},
            **{"log_evidence": round(told.log_evidence, 4), "log_evidence_se": round(told.standard_error, 4)},
            "problems": "" if told.mixed else "tempering chains did not settle",
        }
    for rung in rungs:
        row = {"posterior": name, "rung": rung.name, "reached": watch.reached(rung)}
        row["own_cpu_s"] = round(watch.spent(rung), 2)
        if not row["reached"] or (rung.several and len(base.fit.modes) == 1):
            yield row | {"reached": False}
        elif rung.says and base.fit.n_steps in (SHORT[1], USUAL[1]):  # it asked for no more steps: the draws are those
            left = [one for one in base.fit.list_problems() if rung.says not in one]
            yield (
                row
                | own
                | {
                    "cpu_ratio": round(1.0 - watch.spent(rung) / base.seconds, 2),
                    "problems": "; ".join(left),
                }
            )
        else:
            yield row | take_off(subject, rung, base, reference)


def take_off(subject: Subject, rung: Rung, base: Found, reference: Found) -> dict[str, object]:
    """Return what is found without a rung."""
    try:
        with rung.switched_off():
            found = fit(subject, SEED, SamplerConfig(), EFFORT)
    except (NumericalError, np.linalg.LinAlgError) as error:
        return {"problems": f"failed: {error}"}
    return {"cpu_ratio": round(found.seconds / base.seconds, 2), **describe(found), **compare(found, reference)}


def main() -> None:
    """Fit all posteriors without each rung, write the table and print its summary."""
    every = list_posteriors()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--posteriors", nargs="+", default=[""], metavar="PART", help=f"of {'; '.join(every)}")
    parser.add_argument(
        "--rungs", nargs="+", default=[""], metavar="PART", help=f"of {'; '.join(r.name for r in RUNGS)}"
    )
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tabulate", type=Path)
    given = parser.parse_args()
    if given.tabulate is not None:
        print(tabulate(pd.read_csv(given.tabulate, keep_default_na=True)))
        return
    rungs = [rung for rung in RUNGS if any(part in rung.name for part in given.rungs)]
    rows: list[dict[str, Any]] = []
    if given.out is not None and given.out.exists():
        rows = pd.read_csv(given.out).to_dict("records")
    known = {row["posterior"] for row in rows}
    fit(every["planted: skewed"](), SEED, SamplerConfig(), EFFORT)  # what is imported once
    for name, make in every.items():
        if name in known or not any(part in name for part in given.posteriors):
            continue
        began = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows += ablate(name, make(), rungs)
        print(f"{name}: {time.process_time() - began:.0f} CPU s", flush=True)
        if given.out is not None:
            given.out.parent.mkdir(parents=True, exist_ok=True)
            pd.DataFrame(rows).to_csv(given.out, index=False)
    print(tabulate(pd.DataFrame(rows)))


def judge(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of rungs that changed something, with what everything on says and what is wrong without them."""
    everything = table[table["rung"] == ALL].set_index("posterior")
    found = table[table["reached"] & ~table["rung"].str.startswith("(") | (table["rung"] == ALL)].copy()
    found["problems"] = found["problems"].fillna("")
    own = everything.loc[found["posterior"]]
    chance, elpd = own["quantile_sd"].to_numpy(), own["elpd_nat"].fillna(0.0).to_numpy()
    found["own_problems"] = own["problems"].fillna("").to_numpy()
    found["failed"] = found["problems"].str.startswith("failed")
    found["evidence_wrong"] = (found["evidence_nat"].abs() > WRONG_NATS) & (found["evidence_se"] > WRONG_ERRORS)
    found["quantile_wrong"] = found["quantile_sd"] > np.maximum(WRONG_SD, ABOVE_CHANCE * chance)
    found["rows_wrong"] = (found["elpd_nat"].fillna(0.0) - elpd).abs() > WRONG_ELPD
    found["wrong"] = found[["evidence_wrong", "quantile_wrong", "failed"]].any(axis=1)
    found["reported"] = found["problems"] != ""
    found["condemned"] = ~found["wrong"] & found["reported"] & (found["own_problems"] == "")
    found["slower"] = found["cpu_ratio"] > SLOWER
    found["own_cpu"] = own["cpu_s"].to_numpy()
    return found


def tabulate(table: pd.DataFrame) -> str:
    """Return a line a rung in Markdown: what moves without it, the worst wrong answer, what it costs."""
    found = judge(table)
    total = found.loc[found["rung"] == ALL, "cpu_s"].sum()
    lines = [
        "| rung | changes | wrong without (unreported) | right, but condemned | slower | worst wrong answer without it "
        "| reported | CPU without it | own share |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for rung in RUNGS:
        rows = found[found["rung"] == rung.name]
        wrong = rows[rows["wrong"] & ((rows["own_problems"] == "") | ~rows["reported"])]
        spent = 100.0 * table.loc[table["rung"] == rung.name, "own_cpu_s"].sum() / total
        ratio = rows["cpu_s"].sum() / rows["own_cpu"].sum() if len(rows) else 1.0
        unreported = int((~wrong["reported"]).sum())
        lines.append(
            f"| {rung.name} | {len(rows)} | {len(wrong)} ({unreported}) | {rows['condemned'].sum()} "
            f"| {rows['slower'].sum()} | {tell_worst(wrong)} | {ratio:.2f} | {spent:.1f} % |"
        )
    return "\n".join([*lines, "", *tell_checks(table, found)])


def tell_worst(wrong: pd.DataFrame) -> str:
    """Return the worst of wrong answers, those that nobody reports first, and whether it was reported."""
    if wrong.empty:
        return "| "
    size = np.maximum(wrong["evidence_nat"].abs() / WRONG_NATS, wrong["quantile_sd"] / WRONG_SD).fillna(0.0)
    worst = wrong.loc[(size + 1e6 * ~wrong["reported"]).idxmax()]
    if worst["failed"]:
        return f"{worst['posterior']}: {worst['problems']} | yes"
    off = f"{worst['evidence_nat']:+.2f} nat, {worst['quantile_sd']:.2f} sd"
    return f"{worst['posterior']}: {off} | {'yes' if worst['reported'] else '**no**'}"


def tell_checks(table: pd.DataFrame, found: pd.DataFrame) -> list[str]:
    """Return what each check says of wrong answers, whichever rung is off, and how many nobody else reports."""
    answers = found[~found["rung"].isin([rung.name for rung in RUNGS if rung.says]) & ~found["failed"]]
    told = table[table["rung"] == TEMPERED].set_index("posterior")
    said = {name: answers["problems"].str.contains(name, regex=False) for name in CHECKS}
    kinds = answers["problems"].map(lambda text: len([one for one in CHECKS if one in text]))
    value, own = (answers["posterior"].map(told[name]) for name in ("log_evidence", "log_evidence_se"))
    error = np.hypot(answers["log_evidence_se"], own).clip(lower=LEAST_ERROR)
    said["tempering, on demand"] = (answers["log_evidence"] - value).abs() / error > TEMPERED_LIMIT
    wrong = answers["wrong"]
    lines = [
        f"{wrong.sum()} wrong answers of {len(answers)}, {(wrong & ~answers['reported']).sum()} of them unreported.",
        "",
    ]
    lines += [
        "| check | wrong answers it reports | that no other does | right answers it condemns alone |",
        "|---|---|---|---|",
    ]
    for name, one in said.items():
        alone = one & (kinds == (name in CHECKS))
        lines.append(f"| {name} | {(one & wrong).sum()} | {(alone & wrong).sum()} | {(alone & ~wrong).sum()} |")
    return lines


if __name__ == "__main__":
    main()
