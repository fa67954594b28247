"""Make coins.png: where 1,000 coins end, by the program that the README shows.

With rollkane and its plot extra installed:

    python docs/images/make_coins.py
"""

import os
import re
from pathlib import Path

HERE = Path(__file__).parent
README = HERE.parents[1] / "README.md"


def main():
    """Run the README's program that writes coins.png, in this file's folder."""
    programs = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    (program,) = [text for text in programs if '"coins.png"' in text]
    os.chdir(HERE)
    exec(compile(program, str(README), "exec"), {})


if __name__ == "__main__":
    main()
