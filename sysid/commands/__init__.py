"""The commands of ``sysid``: arguments here are light, the work is loaded when a command runs."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from sysid.commands import (
    data_arguments,
    demo_arguments,
    effects_arguments,
    fit_arguments,
    models_arguments,
    replicate_arguments,
)
from sysid.diagnosis import command as compare
from sysid.diagnosis import diagnose_command as diagnose

Run = Callable[[argparse.Namespace], int]


@dataclass(frozen=True)
class Command:
    """One command: its help, its arguments and how to load what it does."""

    name: str
    summary: str
    description: str
    example: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    load: Callable[[], Run]


def _replicate() -> Run:
    from sysid.commands.replicate import run

    return run


def _data() -> Run:
    from sysid.commands.data import run

    return run


def _models() -> Run:
    from sysid.commands.models import run

    return run


def _demo() -> Run:
    from sysid.commands.demo import run

    return run


def _effects() -> Run:
    from sysid.commands.effects import run

    return run


def _fit() -> Run:
    from sysid.commands.fit import run

    return run


COMMANDS = (
    Command(
        "replicate",
        "regenerate the tables and figures of papers and check them against gates",
        "Regenerate the tables and figures of papers, check them against gates, write HTML and PDF reports.",
        "sysid replicate bai --runs 1000 --jobs 2 --out replication --format html,pdf",
        replicate_arguments.add,
        _replicate,
    ),
    Command(
        "compare",
        compare.HELP,
        "Fit a model on the estimation rows of a measurement file, judge its free run on held-out rows.",
        "sysid compare motor.csv --input u --output y --period 0.01 --split-column set",
        compare.add_arguments,
        lambda: compare.run,
    ),
    Command(
        "diagnose",
        diagnose.HELP,
        diagnose.DESCRIPTION,
        diagnose.EXAMPLE,
        diagnose.add_arguments,
        lambda: diagnose.run,
    ),
    Command(
        "fit",
        "fit a block-structured model with a static map to measurements",
        "Fit a model with a static map inside a linear part on the estimation rows of a measurement file, "
        "judge its free run on held-out rows, show the map.",
        "sysid fit motor.csv --structure lft --period 0.01 --split-column set --save motor.json",
        fit_arguments.add,
        _fit,
    ),
    Command(
        "data",
        "list, describe and fetch public benchmark records",
        "List, describe and fetch public benchmark records.  SYSID_DATA names a folder of local copies, "
        "<name>/<name>.csv[.gz] with <name>.json beside it.",
        "sysid data info emps",
        data_arguments.add,
        _data,
    ),
    Command(
        "models",
        "list the physical models with their equations and parameters",
        "List physical models: equations, states, inputs and parameters with unit, start value and range.",
        "sysid models dc-motor",
        models_arguments.add,
        _models,
    ),
    Command(
        "effects",
        "list and explain the effects a model may lack",
        "List the effects that `sysid diagnose` looks for; explain those that are named: mechanism, "
        "equation, signature, look-alikes, parameters.",
        "sysid effects coulomb in_backlash",
        effects_arguments.add,
        _effects,
    ),
    Command(
        "demo",
        "make a record with a hidden effect, to try the diagnosis on",
        "Make a record of a plant that has more in it than its model; what it is stays sealed till --reveal.",
        "sysid demo --out demo --seed 1",
        demo_arguments.add,
        _demo,
    ),
)
