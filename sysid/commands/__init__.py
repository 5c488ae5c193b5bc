"""The commands of ``sysid``: arguments here are light, the work is loaded when a command runs."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from sysid.commands import (
    compare_arguments,
    data_arguments,
    demo_arguments,
    diagnose_arguments,
    effects_arguments,
    fit_arguments,
    models_arguments,
    replicate_arguments,
)

Run = Callable[[argparse.Namespace], int]


@dataclass(frozen=True)
class Command:
    """One command: its help, its arguments and how to load what it does."""

    name: str
    summary: str
    description: str
    example: str
    add_arguments: Callable[[argparse.ArgumentParser], None]

    def load(self) -> Run:
        """Return what does the work, from the module of the command's name."""
        run: Run = import_module(f"sysid.commands.{self.name}").run
        return run


COMMANDS = (
    Command(
        "replicate",
        "regenerate the tables and figures of papers and check them against gates",
        "Regenerate the tables and figures of papers, check them against gates, write HTML and PDF reports.",
        "sysid replicate bai --runs 1000 --jobs 2 --out replication --format html,pdf",
        replicate_arguments.add,
    ),
    Command(
        "compare",
        "compare a model with measurements on held-out data",
        "Fit a model on the estimation rows of a measurement file, judge its free run on held-out rows.",
        "sysid compare motor.csv --input u --output y --period 0.01 --split-column set",
        compare_arguments.add,
    ),
    Command(
        "diagnose",
        "learn which physical effect a model lacks, and add it",
        "Fit a model on the estimation rows of a measurement file, name the physical effect it lacks, add it "
        "where all evidence agrees, and show the free-run error fall.",
        "sysid diagnose motor.csv --model dc-motor --period 0.01 --split-column set --json motor.json",
        diagnose_arguments.add,
    ),
    Command(
        "fit",
        "fit a block-structured model with a static map to measurements",
        "Fit a model with a static map inside a linear part on the estimation rows of a measurement file, "
        "judge its free run on held-out rows, show the map.",
        "sysid fit motor.csv --structure lft --period 0.01 --split-column set --save motor.json",
        fit_arguments.add,
    ),
    Command(
        "data",
        "list, describe and fetch public benchmark records",
        "List, describe and fetch public benchmark records.  SYSID_DATA names a folder of local copies, "
        "<name>/<name>.csv[.gz] with <name>.json beside it.",
        "sysid data info emps",
        data_arguments.add,
    ),
    Command(
        "models",
        "list the physical models with their equations and parameters",
        "List physical models: equations, states, inputs and parameters with unit, start value and range.",
        "sysid models dc-motor",
        models_arguments.add,
    ),
    Command(
        "effects",
        "list and explain the effects a model may lack",
        "List the effects that `sysid diagnose` looks for; explain those that are named: mechanism, "
        "equation, signature, look-alikes, parameters.",
        "sysid effects coulomb in_backlash",
        effects_arguments.add,
    ),
    Command(
        "demo",
        "make a record with a hidden effect, to try the diagnosis on",
        "Make a record of a plant that has more in it than its model; what it is stays sealed till --reveal.",
        "sysid demo --out demo --seed 1",
        demo_arguments.add,
    ),
)
