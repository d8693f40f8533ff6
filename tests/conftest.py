"""One hypothesis profile for all: the same examples in every run, and no clock (the first call of a kernel compiles it)."""

from hypothesis import HealthCheck, settings

settings.register_profile("cnc", derandomize=True, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("cnc")
