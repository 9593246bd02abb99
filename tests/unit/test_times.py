"""Times as text: in UTC in rooms and for programs, in the zone of the reader for people."""

import json
import re
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click
import pytest

import pqsec_pki
from pqsec_pki._times import exact, rfc3339, said
from pqsec_pki.cli._formats import as_csv
from pqsec_pki.cli._printing import as_json, table
from pqsec_pki.cli._settings import Duration, WaitingTime, When
from pqsec_pki.cli._times import day, local

ZONES = {
    "Europe/Madrid": "CET-1CEST,M3.5.0,M10.5.0/3",
    "Asia/Kolkata": "IST-5:30",
    "America/Sao_Paulo": "<-03>3",
    "UTC": "UTC0",
}
"""Name -> its rule as POSIX has it, for machines without a table of zones."""


@pytest.fixture
def zone(monkeypatch):
    """zone("Asia/Kolkata") is where this process is from then on."""

    def use(name):
        known = Path("/usr/share/zoneinfo", name).exists()
        monkeypatch.setenv("TZ", name if known else ZONES[name])
        time.tzset()

    yield use
    monkeypatch.undo()
    time.tzset()


WHEN = datetime(2026, 11, 24, 2, 10, 9, tzinfo=UTC)


@pytest.mark.parametrize(
    ("name", "shown", "date"),
    [
        ("UTC", "2026-11-24 02:10:09 UTC", "2026-11-24"),
        ("Europe/Madrid", "2026-11-24 03:10:09 CET", "2026-11-24"),
        ("Asia/Kolkata", "2026-11-24 07:40:09 IST", "2026-11-24"),
        ("America/Sao_Paulo", "2026-11-23 23:10:09 -03", "2026-11-23"),
    ],
)
def test_people_get_the_time_of_their_zone_and_its_name(zone, name, shown, date):
    zone(name)
    assert local(f"it ended on {exact(WHEN)}: renew it") == f"it ended on {shown}: renew it"
    assert local(f"({said(WHEN)})") == f"({shown[:16]}{shown[19:]})"
    assert day(WHEN) == date


def test_summer_time_is_that_of_the_time_and_not_of_today(zone):
    zone("Europe/Madrid")
    before, after = (
        datetime(2026, 10, 25, 0, 30, tzinfo=UTC),
        datetime(2026, 10, 25, 1, 30, tzinfo=UTC),
    )
    both = local(f"{said(before)} to {said(after)}")
    assert both == "2026-10-25 02:30 CEST to 2026-10-25 02:30 CET"
    skipped = datetime(2026, 3, 29, 1, 0, tzinfo=UTC)
    assert local(said(skipped)) == "2026-03-29 03:00 CEST"


@pytest.mark.parametrize(
    ("name", "shown"),
    [("Asia/Kolkata", "9999-12-31 23:00 UTC"), ("America/Sao_Paulo", "9999-12-31 20:00 -03")],
)
def test_a_time_that_a_zone_cannot_have_stays_in_utc(zone, name, shown):
    """Certificates without an end have this one (RFC 5280, 4.1.2.5)."""
    zone(name)
    last = datetime(9999, 12, 31, 23, 0, tzinfo=UTC)
    assert (local(said(last)), day(last)) == (shown, "9999-12-31")


@pytest.mark.parametrize(
    "text",
    [
        "2026-99-24 02:10 UTC",
        "2026-11-24 02:10",
        "12026-11-24 02:10 UTC",
        "begins at 02:10 UTC, which Fast DDS reads as local time",
        "2026-11-24 02:10 UTCX",
    ],
)
def test_other_text_stays(zone, text):
    zone("Asia/Kolkata")
    assert local(text) == text


def test_the_columns_of_a_table_stay_below_each_other(zone):
    zone("Europe/Madrid")
    summer = datetime(2026, 7, 1, 12, 0, tzinfo=UTC)
    lines = table(("when", "what"), [(said(WHEN), "a"), (said(summer), "b")])
    assert lines == [
        "when                   what",
        "2026-11-24 03:10 CET   a",
        "2026-07-01 14:00 CEST  b",
    ]


@pytest.mark.parametrize("name", ZONES)
def test_programs_get_utc_that_ends_in_z_in_every_zone(zone, name):
    zone(name)
    assert rfc3339(WHEN) == "2026-11-24T02:10:09Z"
    value = {"at": WHEN, "as text": WHEN.isoformat(), "nested": [{"at": WHEN}], "words": said(WHEN)}
    found = json.loads(as_json(value))
    z = "2026-11-24T02:10:09Z"
    assert (found["at"], found["as text"], found["nested"]) == (z, z, [{"at": z}])
    assert found["words"] == "2026-11-24 02:10 UTC"
    [_, row] = as_csv(["at", "text"], [{"at": WHEN, "text": WHEN.isoformat()}])
    assert row == f"{z},{z}"


def test_text_that_only_has_a_time_in_it_is_left_to_programs_as_it_is():
    for text in (f"at {WHEN.isoformat()}", f'"{WHEN.isoformat()}"', f"{WHEN.isoformat()} or so"):
        assert json.loads(as_json({"text": text}))["text"] == text


def test_a_time_that_is_typed_is_in_the_zone_in_which_times_are_shown(zone):
    zone("Europe/Madrid")
    read = When().convert
    assert read("2026-07-01 14:00", None, None) == datetime(2026, 7, 1, 12, 0, tzinfo=UTC)
    for text in ("2026-07-01T12:00Z", "2026-07-01T16:00+04:00"):
        found = read(text, None, None)
        assert (found, found.tzinfo) == (datetime(2026, 7, 1, 12, 0, tzinfo=UTC), UTC)


def test_only_these_modules_write_times():
    """Another format would not be found, and shown in UTC beside times that are not."""
    root = Path(pqsec_pki.__file__).parent
    writing = {
        str(path.relative_to(root))
        for path in root.rglob("*.py")
        if re.search(r"strftime|:%[YHMdST]|%Y-%m", path.read_text())
    }
    assert writing == {
        "_times.py",
        "cli/_times.py",
        "report/page.py",  # months and days of a file
        "plugin/notes.py",  # a line of a log
        "lint/enclaves/validity.py",  # what a document has, in UTC
    }


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90), ("5m", 300), ("2h", 7200)])
def test_a_command_waits_also_for_minutes(text, seconds):
    assert WaitingTime().convert(text, None, None) == timedelta(seconds=seconds)


@pytest.mark.parametrize(
    ("kind", "text", "instead"), [(Duration, "5m", "write 10y"), (WaitingTime, "1y", "write 90s")]
)
def test_a_validity_has_no_minutes_and_nobody_waits_for_years(kind, text, instead):
    with pytest.raises(click.BadParameter, match=instead):
        kind().convert(text, None, None)
