"""Settings that every test shares; helpers live beside the tests that use them."""

import pytest
from hypothesis import settings

settings.register_profile("everyday", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=1000)
settings.load_profile("everyday")


@pytest.fixture(scope="module", params=["reference", "compiled"])
def assignment_kernel(request):
    """Runs a module's tests once over each kernel of pmbm.assignment."""
    from pmbm import assignment
    from pmbm.assignment import reference

    chosen = assignment._kernel
    if request.param == "compiled":
        kernel = pytest.importorskip("pmbm._native", reason="installed without a compiler")
    else:
        kernel = reference
    assignment._kernel = kernel
    yield request.param
    assignment._kernel = chosen
