"""Files that a user gives: the work of refusing them is bounded."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.runtime import input_files
from bayes_impedance.runtime.input_files import decode, line_of, parse_toml, read_bytes, read_json, read_toml

TEXT = b"0123456789" * 1000


def test_plain_and_packed_files_give_the_same(tmp_path: Path) -> None:
    file = tmp_path / "file"
    for content in (TEXT, gzip.compress(TEXT), gzip.compress(TEXT[:7]) + gzip.compress(TEXT[7:]) + bytes(100)):
        file.write_bytes(content)
        assert read_bytes(file) == TEXT
        assert read_bytes(file, len(TEXT)) == TEXT
        with pytest.raises(InputError, match="larger than"):
            read_bytes(file, len(TEXT) - 1)
    file.write_bytes(gzip.compress(b""))
    assert read_bytes(file) == b""


@pytest.mark.parametrize(
    "packed", [gzip.compress(bytes(2**24), 9), gzip.compress(bytes(2**20), 9) * 16], ids=["one", "several"]
)
def test_no_more_is_unpacked_than_is_allowed(tmp_path: Path, packed: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    import zlib

    unpacked = 0
    original = zlib.decompressobj

    class Counting:
        def __init__(self, **options: int) -> None:
            self.inner = original(**options)

        def decompress(self, data: bytes, most: int) -> bytes:
            nonlocal unpacked
            part = self.inner.decompress(data, most)
            unpacked += len(part)
            return part

        def __getattr__(self, name: str) -> object:
            return getattr(self.inner, name)

    monkeypatch.setattr(zlib, "decompressobj", Counting)
    file = tmp_path / "bomb.gz"
    file.write_bytes(packed)
    with pytest.raises(InputError, match="larger than 2 MiB"):
        read_bytes(file, 2**21)
    assert unpacked <= 2**22


@pytest.mark.parametrize(
    "content",
    [b"\x1f\x8b", gzip.compress(TEXT)[:-9], gzip.compress(TEXT) + b"more"],
    ids=["start only", "cut short", "more behind it"],  # not its bytes: they contain the time
)
def test_damaged_gzip_is_said(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "file.gz"
    file.write_bytes(content)
    with pytest.raises(InputError, match="damaged or cut short"):
        read_bytes(file)


def test_a_file_without_end_is_not_read_to_its_end() -> None:
    with pytest.raises(InputError, match="larger than"):
        read_bytes(Path("/dev/zero"), 2**20)


def test_text_that_is_none() -> None:
    assert decode(b"\xef\xbb\xbfx", "f") == "x"
    for data, words in ((b"\xff\xfex", "UTF-16"), (b"a\0", "binary"), (b"a\n\xe9", "row 2: .*byte 0xe9")):
        with pytest.raises(InputError, match=words):
            decode(data, "f")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("x = " + "{a = " * 5000 + "1" + "}" * 5000, "nested too deeply"),
        (f"x = {'1' * 5000}", "thousands of digits"),
        ("x = \ny = 1", "line 1 is not valid TOML"),
        ('x = "', "not valid TOML"),
    ],
)
def test_toml_that_is_none(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as told:
        parse_toml(text, "f.toml")
    assert len(str(told.value)) < 200


def test_dotted_keys_may_be_deep() -> None:
    assert "a" in parse_toml(".".join(["a"] * 2000) + " = 1", "f.toml")


def test_descriptions(tmp_path: Path) -> None:
    file = tmp_path / "file"
    with pytest.raises(InputError, match="no such file; give a device as TOML"):
        read_toml(file, "a device")
    file.write_text("x = 1", encoding="utf-8")
    assert read_toml(file, "a device") == {"x": 1}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "Expecting value"),
        (b"{", "Expecting property name"),
        (b"[1]", "no object"),
        (b"null", "no object"),
        (b"\xff", "not UTF-8"),
        (b"\xff\xfe{\0}\0", "not UTF-8"),
        (b'{"a": NaN}', "NaN is not a number in JSON"),
        (b'{"a": -Infinity}', "-Infinity is not a number in JSON"),
        (b'{"a":' * 100_000, "nested too deeply"),
        (b"[" * 200_000, "nested too deeply"),
        (b"9" * 5000, "thousands of digits"),
    ],
)
def test_what_is_no_object_of_json_is_one_sentence(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "a.json"
    file.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_json(file, "do this")
    told = str(caught.value)
    assert told.startswith(f"{file}: cannot be read as JSON (")
    assert words in told
    assert told.endswith("); do this")
    assert len(told) < len(str(file)) + 120


def test_objects_of_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a.json"
    with pytest.raises(InputError, match=r"a\.json: there is no such file; do this"):
        read_json(file, "do this")
    with pytest.raises(InputError, match="cannot be read"):
        read_json(tmp_path, "do this")
    for content in (b'{"a": [1]}', b'\xef\xbb\xbf{"a": [1]}', gzip.compress(b'{"a": [1]}')):
        file.write_bytes(content)
        assert read_json(file, "do this") == {"a": [1]}
    monkeypatch.setattr(input_files, "LARGEST_JSON", 20)
    with pytest.raises(InputError, match="larger than"):
        read_json(file, "do this")


def test_lines_of_keys() -> None:
    assert [line_of("a = 1\n b = 2\n[c]\n", key) for key in ("a", "b", "c", "d")] == [1, 2, 3, 1]
