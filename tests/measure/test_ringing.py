"""Modes of a frame that rings, from records of an accelerometer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.measure.ringing import modes, read_record
from cnc.model.diagnostics import UsageError
from tests.support.soak import share


def ringing(rng, true, *, rate=1000.0, seconds=6.0, noise=0.02):
    """Samples of a frame that is struck now and then: the exact response of each mode."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    total = np.zeros(len(t))
    for blow in np.arange(0.3, seconds - 0.4, 0.8) + rng.uniform(0.0, 0.1):
        after = np.maximum(t - blow, 0.0)
        for frequency, damping, weight in true:
            w = 2.0 * np.pi * frequency
            wave = np.exp(-damping * w * after) * np.sin(w * np.sqrt(1.0 - damping**2) * after)
            total += rng.uniform(0.6, 1.4) * weight * wave * (t >= blow)
    return total + noise * rng.standard_normal(len(t)) + 9.81


@settings(max_examples=share(40, 10), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rate=st.sampled_from([500.0, 800.0, 3200.0]))
def test_two_modes_are_measured_to_one_per_cent(seed, rate):
    rng = np.random.default_rng(seed)
    low = rng.uniform(15.0, 50.0)
    high = low * rng.uniform(1.4, 2.2)
    true = [(low, rng.uniform(0.02, 0.08), 1.0), (high, rng.uniform(0.02, 0.06), 1.0)]
    measured = modes(ringing(rng, true, rate=rate), rate)
    assert len(measured) == 2
    for (frequency, damping, _), mode in zip(true, measured, strict=True):
        assert mode.frequency == pytest.approx(frequency, rel=0.01)
        assert mode.damping == pytest.approx(damping, abs=0.01)


def test_one_mode_is_one():
    rng = np.random.default_rng(5)
    (mode,) = modes(ringing(rng, [(38.0, 0.05, 1.0)]), 1000.0)
    assert mode.frequency == pytest.approx(38.0, rel=0.01)
    assert mode.share > 0.9


@pytest.mark.parametrize(
    ("heading", "separator", "scale"),
    [
        ("time,accel_x,accel_y,accel_z", ",", 1.0),
        ("#time,accel_x,accel_y,accel_z", ",", 1.0),
        ('"Time (s)"\t"Acceleration x (m/s^2)"\t"Acceleration y (m/s^2)"\t"z (m/s^2)"', "\t", 1.0),
        ("t ms;ax;ay;az", ";", 1000.0),
        ("", ",", 1.0),
    ],
)
def test_records_of_phones_and_boards_are_read(tmp_path, heading, separator, scale):
    rng = np.random.default_rng(1)
    columns = [ringing(rng, [(f, 0.04, 1.0)]) for f in (38.0, 61.0, 25.0)]
    times = np.arange(len(columns[0])) / 1000.0 + rng.uniform(-1e-4, 1e-4, len(columns[0]))
    table = np.stack((times * scale, *columns), axis=1).tolist()
    rows = [separator.join(f"{value:.6f}" for value in row) for row in table]
    file = tmp_path / "record.csv"
    file.write_text("\n".join([*([heading] if heading else []), *rows, ""]))
    record = read_record(file)
    assert record.rate == pytest.approx(1000.0, rel=1e-3)
    for letter, frequency in zip("xyz", (38.0, 61.0, 25.0), strict=True):
        measured = modes(record.columns[letter], record.rate)
        assert measured[0].frequency == pytest.approx(frequency, rel=0.01)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not a table"),
        ("time,x\n1,2\nhello,3\n", "has no numbers"),
        ("1,2\n1,3\n", "do not rise"),
        ("0,1\n1,2\n2,nan\n", "do not rise"),
        ("0,1\n1,2\n2,3\n", "samples a second"),
        ("0,1\n0.001,2,3\n", "not a table"),
        ("\n".join(f"{0.001 * k + (k > 50)},1" for k in range(100)), "samples a second"),
        ("\n".join(f"{0.001 * k + 0.1 * (k > 500)},1" for k in range(1000)), "gaps"),
    ],
)
def test_a_file_that_is_no_record_is_refused(tmp_path, text, reason):
    file = tmp_path / "record.csv"
    file.write_text(text)
    with pytest.raises(UsageError) as refused:
        read_record(file)
    assert refused.value.diagnostic.code == "record-form"
    assert reason in refused.value.diagnostic.message


def test_noise_alone_has_no_mode():
    rng = np.random.default_rng(3)
    with pytest.raises(UsageError, match="ring"):
        modes(rng.standard_normal(5000), 1000.0)
