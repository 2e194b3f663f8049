"""The tool that measures are compared with, for tests alone: to import it takes ten seconds."""

from __future__ import annotations

import warnings

import pytest


@pytest.fixture(scope="session")
def porespy():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the libraries that it imports
        import porespy

        porespy.settings.tqdm["disable"] = True
        return porespy
