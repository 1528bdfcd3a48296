"""``defocus verify`` tells what it measured, and its exit code whether all of it holds."""

import pytest
from command_line import Terminal, run

from defocus_core.evaluation import lens_laws
from defocus_core.evaluation.lens_laws import Check, LawSetting

HOLDS = Check("white stays white", "white over a slope", "-", 3e-7, 1e-5)
BROKEN = Check("PSF radius", "off r", "%", 2.5, 1.0)
NOT_A_NUMBER = Check("energy", "off 1", "-", float("nan"), 1e-6)
SKIPPED = Check("CPU and GPU", "difference", "-", None, 1e-4)


def use(monkeypatch, *checks):
    """Have these checks found; returns the settings they were asked with."""
    asked: list[LawSetting] = []

    def law(setting):
        asked.append(setting)
        return list(checks)

    monkeypatch.setattr(lens_laws, "LAWS", (law,))
    return asked


def test_laws_hold_here(monkeypatch):
    monkeypatch.setattr(lens_laws, "LAWS", (lens_laws.LAWS[0], lens_laws.devices))
    ran = run("verify", "--device", "cpu", "--quality", "draft", "--threads", "1")
    assert (ran.code, ran.err) == (0, "")
    heading, *lines, last = ran.out.splitlines()
    assert heading.split() == ["law", "measured", "worst", "bound", "unit"]
    assert len(lines) >= 2
    assert all(line.endswith((" ok", "skipped: no GPU in use")) for line in lines)
    assert last.startswith(f"all {len(lines) - 1} hold, ")
    assert last.endswith(" (cpu, draft, 1 thread)")


def test_the_table_names_what_fails_and_what_was_skipped(monkeypatch):
    use(monkeypatch, HOLDS, BROKEN, SKIPPED)
    ran = run("verify")
    assert ran.code == 1
    assert ran.err == ""
    _, holds, broken, skipped, last = ran.out.splitlines()
    assert holds.split()[-4:] == ["3e-07", "1e-05", "-", "ok"]
    assert broken.split()[-4:] == ["2.5", "1", "%", "FAILED"]
    assert skipped.endswith("skipped: no GPU in use")
    assert last.startswith("1 of 2 FAILED, ")


@pytest.mark.parametrize("found", [HOLDS, BROKEN, NOT_A_NUMBER, SKIPPED])
def test_json_says_the_same(found, monkeypatch):
    asked = use(monkeypatch, found)
    ran = run("verify", "--json", "--device", "cpu", "--quality", "high", "--threads", "3")
    assert asked == [LawSetting("cpu", "high", 3)]
    assert ran.code == (0 if found.ok else 1)
    told = ran.json
    assert (told["device"], told["quality"], told["threads"]) == ("cpu", "high", 3)
    assert told["ok"] is found.ok
    (record,) = told["checks"]
    assert record["ok"] is found.ok
    assert record["skipped"] is (found is SKIPPED)
    assert record["value"] == (found.value if found in (HOLDS, BROKEN) else None)
    assert (record["law"], record["measured"]) == (found.law, found.measured)
    assert (record["unit"], record["bound"]) == (found.unit, found.bound)


def test_a_person_who_watches_sees_progress(monkeypatch):
    use(monkeypatch, HOLDS)
    ran = run("verify", err=Terminal())
    assert ran.code == 0
    assert "law" in ran.err
    assert "it/s" not in ran.out
