"""Device TOML: nothing that a user wrote is left aside, and no default stands in for what was misspelt."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayes_impedance.design.loop.device import PHANTOM, Device, Section, read_device
from bayes_impedance.errors import InputError

GOOD = """name = "coil"
period_s = 5e-4
delay_s = 1e-4
source = "data sheet"
[[section]]
arrangement = "beside"
network = "m1|r1"
values = {m1 = 0.03, r1 = 0.2}
units = {m1 = "kg", r1 = "N s/m"}
"""

BAD: dict[str, tuple[str, str, list[str]]] = {
    "delay": ("delay_s", "delay", ['key "delay" is not used', 'did you mean "delay_s"']),
    "periods": ("period_s", "periods", ['key "periods"', 'did you mean "period_s"']),
    "no period": ("period_s = 5e-4\n", "", ['key "period_s" is missing']),
    "sections": ("[[section]]", "[[sections]]", ['key "sections"', 'did you mean "section"']),
    "one table": ("[[section]]", "[section]", ["section is a table", "write [[section]]"]),
    "no section": ("[[section]]", "[other]", ['key "other"']),
    "unknown far": ('source = "data sheet"', "colour = 3", ['key "colour"', "known are name, source"]),
    "boolean period": ("5e-4", "true", ["period_s is true", "finite number"]),
    "boolean value": ("m1 = 0.03", "m1 = true", ["section 1", "m1 is true"]),
    "text value": ("m1 = 0.03", 'm1 = "30 g"', ["section 1", 'm1 is "30 g"']),
    "text period": ("5e-4", '"1 ms"', ['period_s is "1 ms"']),
    "nan": ("1e-4", "nan", ["delay_s is nan"]),
    "infinite": ("5e-4", "inf", ["period_s is inf"]),
    "negative delay": ("1e-4", "-1e-4", ["delay_s is -0.0001", "at least 0"]),
    "period in ms": ("5e-4", "0.5", ["period_s is 0.5", "at most 0.1"]),
    "delay in ms": ("1e-4", "0.1", ["longer than 40 periods", "check its unit"]),
    "huge integer": ("5e-4", "1" * 4000, ["period_s is an integer of 4000 digits"]),
    "huge value": ("m1 = 0.03", "m1 = 1e300", ["m1 is 1e+300", "at most 1e+12"]),
    "name": ('"coil"', "3", ["name is 3", "must be text"]),
    "source": ('"data sheet"', '["a"]', ["source is a list", "must be text"]),
    "misspelt section key": ("arrangement", "arangement", ["section 1", 'did you mean "arrangement"']),
    "misspelt arrangement": ('"beside"', '"besides"', ['did you mean "beside"', "between, lever"]),
    "network is a number": ('"m1|r1"', "3", ["network is 3", "must be text"]),
    "network": ('"m1|r1"', '"m1||r1"', ["character 4"]),
    "surplus element": ("r1 = 0.2}", "r1 = 0.2, r2 = 1.0}", ['"r2" is not used', "m1, r1"]),
    "missing element": (", r1 = 0.2}\nunits", "}\n#", ["'r1' has none", "positive value"]),
    "values is a list": ("{m1 = 0.03, r1 = 0.2}", "[0.03, 0.2]", ["values is a list"]),
    "wrong unit": ('m1 = "kg"', 'm1 = "g"', ['unit of "m1" is "g"', 'convert its value to "kg"']),
    "unit of nothing": ('m1 = "kg"', 'm3 = "kg"', ['unit of "m3"', "take it out"]),
    "units is text": ('{m1 = "kg", r1 = "N s/m"}', '"SI"', ["units is"]),
    "deep": ('"data sheet"', "[" * 5000 + "]" * 5000, ["nested too deeply"]),
}


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD.keys())
def test_bad_devices_are_refused_in_one_sentence(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in GOOD
    file = tmp_path / "device.toml"
    file.write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as told:
        read_device(file)
    message = str(told.value)
    assert message.startswith(str(file))
    assert "\n" not in message
    assert len(message) < 400
    for word in words:
        assert word in message


def test_a_good_device_is_read_and_written_devices_are_read_again(tmp_path: Path) -> None:
    file = tmp_path / "device.toml"
    file.write_text(GOOD.replace("0.2}", "1}"), encoding="utf-8")
    device = read_device(file)
    assert (device.period_s, device.delay_s) == (5e-4, 1e-4)
    assert isinstance(device.sections[0].values["r1"], float)
    lines = []
    for key, value in PHANTOM.described().items():
        if not isinstance(value, list):
            lines.append(f"{key} = {value!r}")
            continue
        for section in value:
            lines += ["[[section]]", f"arrangement = {section['arrangement']!r}", f"network = {section['network']!r}"]
            for name in ("values", "units"):
                lines.append(f"{name} = {{" + ", ".join(f"{k} = {v!r}" for k, v in section[name].items()) + "}")
    file.write_text("\n".join(lines), encoding="utf-8")
    assert read_device(file) == PHANTOM


def test_devices_made_in_python_are_held_to_the_same_rules() -> None:
    parts = (Section("beside", "m1|r1", {"m1": 1, "r1": 1}),)
    with pytest.raises(InputError, match="period_s is true"):
        Device("d", parts, True)
    with pytest.raises(InputError, match="delay_s is nan"):
        Device("d", parts, 1e-3, float("nan"))
    with pytest.raises(InputError, match="ratio and no network"):
        Section("lever", "m1", {"ratio": 2.0})
