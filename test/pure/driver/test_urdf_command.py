"""The command `urdf`."""

import sys

from fss_arm_driver import urdf_command
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_model.urdf import urdf


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["urdf", *map(str, arguments)])
    return urdf_command.main()


def test_the_description_is_printed_or_written(monkeypatch, capsys, tmp_path):
    save(paper_arm(), tmp_path / "arm.yaml")
    assert run(monkeypatch, tmp_path / "arm.yaml") == 0
    assert capsys.readouterr().out == urdf(paper_arm())
    assert run(monkeypatch, "--output", tmp_path / "new/arm.urdf") == 0
    assert (tmp_path / "new/arm.urdf").read_text() == urdf(paper_arm())


def test_a_description_that_is_not_there_ends_in_one_line(monkeypatch, capsys, tmp_path):
    assert run(monkeypatch, tmp_path / "no.yaml") == 1
    assert capsys.readouterr().err.startswith("urdf: ")
