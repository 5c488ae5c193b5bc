"""A synthetic run that exercises everything a report can hold; its numbers mean nothing."""

import atexit
import json
import tempfile
from functools import cache
from pathlib import Path

from sysid.reporting import build

CHAPTER = Path(__file__).parent / "data" / "demo_chapter.txt"
NASTY = '<script>alert("x")</script> #typst $x_1$ *star* _under_ @ref ~ [a](b) \\ "q" `tick` </style>'


def demo_results() -> dict:
    parameters = {
        name: {
            "true": true,
            "mean": true + 0.00123,
            "bias": 0.00123,
            "bias_std_error": 0.00042,
            "std": 0.01331,
            "rmse": 0.01337,
            "q025": true - 0.0261,
            "q975": true + 0.0264,
            "crlb_std": 0.0129,
            "efficiency": 0.94,
        }
        for name, true in {"a": 1.0, "alpha1": -0.8333, "alpha2": -0.1667, "beta1": 1.0, "beta2": 1.0}.items()
    }
    parameters["odd_name $x$"] = dict.fromkeys(parameters["a"])
    gates = [
        {
            "id": f"monte-carlo/case-{number}/bias",
            "value": 0.1234567 * number,
            "lower": 0.0,
            "upper": 2.0 + number,
            "type": "Monte-Carlo band",
            "passed": True,
            "reason": "False alarm of one in a million.",
        }
        for number in range(12)
    ]
    gates += [
        {
            "id": "exact/one",
            "value": 1,
            "lower": 1,
            "upper": 1,
            "type": "exact",
            "passed": True,
            "reason": "",
        },
        {
            "id": "red_gate",
            "value": -0.0071,
            "lower": None,
            "upper": -0.01,
            "type": "slope",
            "passed": False,
            "reason": NASTY,
        },
        {
            "id": "empty",
            "value": None,
            "lower": None,
            "upper": None,
            "type": None,
            "passed": True,
            "reason": None,
        },
    ]
    claims = [
        {
            "id": "table-1/preload/a",
            "where": "Table 1, row 1",
            "printed": 1.0,
            "value": 0.99987123,
            "unit": "",
            "verdict": "replicated",
            "tolerance": {"type": "Monte-Carlo band", "lower": 0.97, "upper": 1.03},
            "passed": True,
            "note": "The printed value lies inside the 95 % band.",
        },
        {
            "id": "nasty_$id$ *x*",
            "where": NASTY,
            "printed": None,
            "value": None,
            "unit": "V",
            "verdict": "not replicated",
            "tolerance": None,
            "passed": False,
            "note": NASTY,
        },
        {
            "id": "theta",
            "where": "Table 1, row 3",
            "printed": [-0.82, -0.16, 1.01, 0.98],
            "value": [-0.83123, -0.16581, 1.00321, 0.99871],
            "unit": None,
            "verdict": "partial",
            "tolerance": {"type": "digits", "digits": 2},
            "passed": None,
            "note": "",
        },
    ]
    provenance = {
        "commit": "3f2a9c0d5b7e41862233445566778899aabbccdd",
        "date": "2025-01-31T12:00:00+00:00",
        "platform": "Linux-6.1-x86_64",
        "seed": 20020101,
        "runs": 1000,
        "versions": {"python": "3.11.9", "numpy": "2.4.6", "scipy": "1.17.1"},
        "data_hashes": {"silver<box>.csv": "9" * 64},
        "scheduler": None,
    }
    paper = {
        "claims": claims,
        "gates": gates,
        "monte_carlo": {"preload": {"n_runs": 1000, "failed": 0, "parameters": parameters}},
        "tables": {},
        "numbers": {},
        "timings": {},
    }
    plain = {
        "title": "A paper without a notebook",
        "claims": claims[:1],
        "gates": gates[:2],
        "monte_carlo": {"case_1": paper["monte_carlo"]["preload"]},
    }
    return {
        "schema": 1,
        "provenance": provenance,
        "papers": {"demo": {"title": "Demo (2002) <&>", **paper}, "plain": plain},
    }


def write_demo(folder: Path) -> Path:
    (folder / "results.json").write_text(json.dumps(demo_results()), encoding="utf-8")
    return folder


@cache
def built_demo() -> Path:
    """Build the demonstration once for all tests of a process; its folder goes away with the process."""
    holder = tempfile.TemporaryDirectory(prefix="sysid-report-")
    atexit.register(holder.cleanup)
    folder = write_demo(Path(holder.name))
    build(folder, notebooks={"demo": CHAPTER})
    return folder
