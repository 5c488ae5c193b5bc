"""The command `sysid models`."""

import subprocess
import sys

import pytest

from sysid.cli import main
from sysid.physics import load_model, model_names


def test_all_models_are_listed_with_equations_and_parameters(capsys):
    assert main(["models"]) == 0
    shown = capsys.readouterr().out
    for name in model_names():
        model = load_model(name)
        assert f"{name}: {model.title}" in shown
        for line in str(model).splitlines():
            assert line in shown
        for parameter in model.parameters:
            assert parameter.unit in shown


def test_one_model_or_a_file_of_the_user(capsys, tmp_path):
    path = tmp_path / "tanks.toml"
    path.write_text((load_model_text("two-tanks")).replace('"-a2*x2"', '"-a2*sqrt(max(x2, 0))"'))
    assert main(["models", "dc-motor", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "J w' = K*i - b*w" in shown
    assert "x2' = a1*x1 - a2*sqrt(max(x2, 0))" in shown
    assert "two-mass" not in shown


def load_model_text(name):
    from importlib.resources import files

    return (files("sysid.physics") / "models" / f"{name}.toml").read_text("utf-8")


@pytest.mark.parametrize("name", ["dc-moter", "nowhere.toml"])
def test_an_unknown_model_is_one_sentence(capsys, name):
    assert main(["models", name]) == 2
    message = capsys.readouterr().err
    assert message.startswith("sysid models: error: ")
    assert message.count("\n") == 1


def test_the_list_needs_no_compiler():
    check = "import sys; from sysid.cli import main; main(['models']); sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], capture_output=True, check=False).returncode == 0
