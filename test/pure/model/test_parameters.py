"""Combinations of parameters that the motion depends on."""

from dataclasses import replace

from numpy.testing import assert_allclose

from fss_arm_model.description import paper_arm
from fss_arm_model.parameters import combination_gradients

ARM = paper_arm()


def test_gradients_are_finite_differences():
    combined, G = combination_gradients(ARM)
    for name, column, h in (("mass", 14, 1e-6), ("b", 18, 1e-7), ("inertia", 22, 1e-7)):
        for i, link in enumerate(ARM.links):
            links = list(ARM.links)
            links[i] = replace(link, **{name: getattr(link, name) + h})
            there = combination_gradients(replace(ARM, links=tuple(links)))[0]
            assert_allclose((there - combined) / h, G[:, column + i], rtol=0, atol=1e-5)
