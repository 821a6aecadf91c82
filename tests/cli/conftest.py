"""Running the command in this process."""

from collections.abc import Callable

import pytest

from webapp.app import main as program

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def expmap(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process and return exit code, standard output and standard error."""

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            program.main([str(a) for a in arguments])
        output = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, output.out, output.err

    return call
