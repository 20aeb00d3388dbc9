"""The study of the paper's tables: its figures, and where it is put."""

import numpy as np
import paper_study
import pytest
from paper_study import (
    END_MARK,
    START_MARK,
    estimate_as_in_paper,
    expected_of_sixteen,
    relative_deviations,
    single_joint,
)


def test_the_paper_s_experiment_hardly_knows_the_inertia():
    rng, found = np.random.default_rng(5), []
    for _ in range(8):
        first, second = np.radians(rng.uniform(-75.0, 75.0, (2, 4)))
        plan = single_joint(first, 1.0) + single_joint(second, -1.0)
        found.append(relative_deviations(estimate_as_in_paper(plan))[0])
    assert 0.5 < min(found) < max(found) < 1.2
    assert 0.75 < np.median(found) < 1.0
    random, total = relative_deviations(estimate_as_in_paper(plan, 0.001))
    assert random < 0.16  # with the base's position
    assert total > 1.0


@pytest.mark.slow
def test_what_cuts_the_deviation_to_10_and_to_1_percent():
    fine = {"position_deviation": 0.001, "heading_deviation": float(np.radians(0.5))}
    random, total = relative_deviations(expected_of_sixteen(16, "I b_i I_0 com_0", **fine))
    assert total < 0.135  # 13 %, as docs/explanation/paper.md has it
    random, total = relative_deviations(expected_of_sixteen(2048, "I b_i I_0 com_0", **fine))
    assert random < 0.0115  # 1.1 %
    assert total < 0.04


def test_the_study_takes_its_place_in_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr(paper_study, "study", lambda: f"{START_MARK}\nnew\n{END_MARK}")
    page = tmp_path / "paper.md"
    page.write_text(f"# Paper\n\nbefore\n\n{START_MARK}\nold\n{END_MARK}\n\n## Workspace\n")
    assert paper_study.main(["--output", str(page)]) == 0
    expected = f"# Paper\n\nbefore\n\n{START_MARK}\nnew\n{END_MARK}\n\n## Workspace\n"
    assert page.read_text() == expected
    page.write_text("# Paper\n\n## Workspace\n")
    assert paper_study.main(["--output", str(page)]) == 0
    assert page.read_text().startswith("# Paper\n\n## Workspace\n\n")
    assert page.read_text().count("new") == 1
