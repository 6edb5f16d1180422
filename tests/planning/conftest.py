"""Plans of these tests are searched from fewer configurations, and their pictures are not drawn."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def _quick(quick_searches):
    """Contacts are as free; of the pictures, 0.5 s each, those that a test calls for itself are drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.probing.contacts.STARTS", 6_000)
        patch.setattr("bayescal.planning.search.HOPELESS", (400, 0.004))
        patch.setattr("bayescal.reporting.figures.plan.plan_picture", lambda plan: b"\x89PNG")
        yield
