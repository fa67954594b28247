"""Files of absurd size or depth are refused with a sentence, before they take long."""

import re

import pytest

from rollkane.files.scene_file_limits import MOST_LEVELS, too_deep, too_long
from rollkane.files.scene_files import SceneFileError, load_scene, scene_text

TEXT = scene_text("rolling-disc").replace("rtol = 1.0e-10", "")
DEEP = ".".join(["a"] * 50_000)  # 100 kB


def outputs(value):
    return re.sub(r"outputs *= *\d+", f"outputs = {value}", TEXT)


REFUSED = {
    "outputs no memory holds": (outputs(10**12), "run.outputs: must be 10000000 or"),
    "outputs no integer holds": (outputs(10**30), "run.outputs: must be 10000000 or"),
    "a key of 50,000 levels": (f"{DEEP} = 1\n{TEXT}", "a key of more than 64 levels"),
    "a table as deep": (f"{TEXT}\n[{DEEP}]\n", "a key of more than 64 levels"),
    "one in quotes": (
        f'x = {{ "b" . {DEEP} . "c" = 1 }}\n{TEXT}',
        "a key of more than 64 levels",
    ),
    "lists in lists": (f"a = {'[' * 300}{']' * 300}\n{TEXT}", "nested too deeply"),
    "20,000 loads": (
        TEXT + '\n[[loads]]\nkind = "drag"\nlinear = 0.0\n' * 20_000,
        "loads: must have 1000 entries at most, not 20000",
    ),
    "a number of 5,000 digits": (
        TEXT.replace("mass = 1.0", f"mass = {'9' * 5000}", 1),
        "a.toml:.*a whole number of too many digits — write it as 1e300",
    ),
    "a file of megabytes": (f"# {'x' * 9_000_000}\n{TEXT}", "leave records"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_a_sentence(tmp_path, name):
    text, says = REFUSED[name]
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(SceneFileError, match=says) as caught:
        load_scene(tmp_path / "a.toml")
    assert len(caught.value.problems) == 1
    assert len(str(caught.value)) < 2000  # however long the line


def test_a_change_of_too_many_digits_is_no_number():
    with pytest.raises(SceneFileError, match=r"body\.mass: must be a number"):
        load_scene("rolling-disc", {"body.mass": "9" * 5000})


def test_a_name_that_no_file_can_have():
    with pytest.raises(SceneFileError, match=r"a\\0b.toml: .*null byte"):
        load_scene("a\0b.toml")


def test_the_first_hundred_problems_are_told(tmp_path):
    keys = "".join(f"k{i} = 1\n" for i in range(20_000))
    (tmp_path / "a.toml").write_text(keys + TEXT)
    with pytest.raises(SceneFileError, match="k0: is an unknown name") as caught:
        load_scene(tmp_path / "a.toml")
    assert len(caught.value.problems) == 100


def test_a_long_line_is_shown_about_its_place(tmp_path):
    line = f"run = {{ duration = 1.0, {' ' * 900} outputs = 1, {' ' * 900} rtol = 1 }}"
    text = re.sub(r"\[run\][\s\S]*", "", TEXT)
    (tmp_path / "a.toml").write_text(f"{line}\n{text}")
    with pytest.raises(SceneFileError, match=r"run.outputs: must be 2 or more") as told:
        load_scene(tmp_path / "a.toml")
    _, shown, caret = str(told.value.problems[0]).split("\n")
    assert len(shown) <= 504
    assert shown[caret.index("^")] == "1"


def test_the_limits_themselves_are_allowed():
    key = ".".join(["a"] * MOST_LEVELS)
    assert too_long(f"{key} = 1") is None
    assert too_long(f"{key}.a = 1") is not None
    # many short keys in a line are not one long one, and dots in text are no levels
    assert too_long(f"x = {{ {', '.join(['a.b = 1'] * 100)} }}") is None
    assert too_long(f"x = '{DEEP}'\ny = \"{'.' * 1000}\" # {'. ' * 1000}") is None
    assert not too_deep({"a": [[1.0]]})
