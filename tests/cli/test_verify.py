"""``defocus verify`` tells what it measured, and its exit code whether all of it holds."""

import pytest
from command_line import run

from defocus_core.evaluation import lens_laws

HOLDS = lens_laws.Law("white", "white over a slope", "-", 1e-5, lambda setting: [3e-7])
BROKEN = lens_laws.Law("disc", "off r", "%", 1.0, lambda setting: [2.5, 0.1])
NOT_A_NUMBER = lens_laws.Law("focus", "change", "-", 1e-6, lambda setting: [float("nan")])
SKIPPED = lens_laws.Law("CPU and GPU", "difference", "-", 1e-4, lambda setting: [])


def test_the_table_names_what_fails_and_what_was_skipped(monkeypatch):
    monkeypatch.setattr(lens_laws, "LAWS", (HOLDS, BROKEN, SKIPPED))
    ran = run("verify")
    assert (ran.code, ran.err) == (1, "")
    _, holds, broken, skipped, last = ran.out.splitlines()
    assert holds.split()[-4:] == ["3e-07", "1e-05", "-", "ok"]
    assert broken.split()[-4:] == ["2.5", "1", "%", "FAILED"]
    assert skipped.endswith("skipped: no GPU in use")
    assert last.startswith("1 of 2 FAILED, ")


@pytest.mark.parametrize("law", [HOLDS, BROKEN, NOT_A_NUMBER, SKIPPED])
def test_json_says_the_same(law, monkeypatch):
    asked: list[lens_laws.LawSetting] = []

    def numbers(setting):
        asked.append(setting)
        return law.numbers(setting)

    monkeypatch.setattr(lens_laws, "LAWS", (law._replace(numbers=numbers),))
    ran = run("verify", "--json", "--device", "cpu", "--quality", "high", "--threads", "3")
    assert asked == [lens_laws.LawSetting("cpu", "high", 3)]
    ok = law in (HOLDS, SKIPPED)
    assert ran.code == (0 if ok else 1)
    told = ran.json
    assert (told["device"], told["quality"], told["threads"]) == ("cpu", "high", 3)
    assert told["ok"] is ok
    (record,) = told["checks"]
    assert record["ok"] is ok
    assert record["skipped"] is (law is SKIPPED)
    assert record["value"] == {HOLDS.name: 3e-7, BROKEN.name: 2.5}.get(law.name)
    assert (record["law"], record["measured"]) == (law.name, law.measured)
    assert (record["unit"], record["bound"]) == (law.unit, law.bound)
