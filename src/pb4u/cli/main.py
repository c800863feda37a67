"""The command line: `pb4u VERB`."""

from __future__ import annotations

import os
import signal
import sys
import traceback
import warnings

from pb4u.errors import InputNote, InputWarning, Interrupted, interrupt_behind, sentence_on

_LONGEST = 1500
"""Characters that a refusal has at most: a screen of a terminal."""


def _one_line_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    if issubclass(category, InputWarning):
        print(f"pb4u: {'note' if issubclass(category, InputNote) else 'warning'}: {message}", file=sys.stderr)


def main() -> None:
    """Run the command line.

    Exit code 0; 1 failed or refused, with one plain sentence; 2 a flag was not understood.
    """
    # Set before numpy is first imported: its matrices are small here, and idle BLAS threads slow everything else down.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    debug = "--debug" in sys.argv
    sys.argv = [argument for argument in sys.argv if argument != "--debug"]
    if not debug:
        warnings.simplefilter("ignore")
        warnings.showwarning = _one_line_warning
    warnings.simplefilter("always", InputWarning)
    answer_signals()
    try:
        # Here, so that an interrupt while they are loaded is one.
        from pb4u.cli.application import app

        app()
    except KeyboardInterrupt as interrupted:
        sys.exit(_tell(interrupted))
    except SystemExit as ended:
        if (interrupt := interrupt_behind(ended)) is not None:
            ended.code = _tell(interrupt)
        raise
    except SystemError as error:
        if (interrupt := interrupt_behind(error)) is None:
            raise
        sys.exit(_tell(interrupt))
    except Exception as error:
        if (sentence := sentence_on(error)) is None:
            raise
        _fail(sentence, debug)


def answer_signals() -> None:
    """Handle SIGTERM and a closed terminal like an interrupt, so that temporary files are removed."""

    def end(number: int, _: object) -> None:
        raise Interrupted(signal=number)

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # What is ignored, as under nohup, stays ignored.
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, end)


def _tell(interrupt: KeyboardInterrupt) -> int:
    """Say what is kept where an interrupt ended the command; the exit code of its signal."""
    print(f"pb4u: interrupted; {str(interrupt) or 'nothing was written'}.", file=sys.stderr)
    return 128 + getattr(interrupt, "signal", 2)


def _fail(sentence: str, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    # What is refused may be quoted, and be a file's whole content.
    print(f"pb4u: {sentence[:_LONGEST]}{' ..' if len(sentence) > _LONGEST else ''}", file=sys.stderr)
    sys.exit(1)
