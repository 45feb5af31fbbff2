"""Progress of long work."""

from numba.core import event

from bayesfric.base.progress import progress_shown


def test_compilation_is_announced_once(capsys):
    with progress_shown(True):
        for _ in range(3):
            with event.trigger_event("numba:compile"):
                pass
    (line,) = filter(str.strip, capsys.readouterr().err.splitlines())
    assert line
