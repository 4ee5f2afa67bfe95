"""Settings that every test shares; helpers live beside the tests that use them."""

from hypothesis import settings

settings.register_profile("everyday", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=1000)
settings.load_profile("everyday")
