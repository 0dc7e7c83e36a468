"""What the chapters share: steps that print a line each, commands, and waiting. What a step expected and did not find is
an `Unexpected`, whose words are its line's; nothing here knows of scand."""

import subprocess
import threading
import time


class Unexpected(Exception):
    """A check found something wrong."""


def run(*command, expected=0, timeout=300, **more):
    """Runs a command and gives what it printed; `expected` is its exit code, `None` any."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, timeout=timeout, stdin=subprocess.DEVNULL, **more)
    said = (done.stdout + done.stderr).strip()
    if expected is not None and done.returncode != expected:
        raise Unexpected(f"{' '.join(words)}: exit code {done.returncode}, expected {expected}: {said[-600:]}")
    return said


def until(what, reached, seconds=240):
    """Waits until `reached()` gives something, and gives it."""
    end = time.monotonic() + seconds
    while True:
        found = reached()
        if found:
            return found
        if time.monotonic() > end:
            raise Unexpected(f"not within {seconds} s: {what}")
        time.sleep(0.1)


def expect(found, expected, what):
    """Compares two values."""
    if found != expected:
        raise Unexpected(f"{what}: {found!r}, expected {expected!r}")


def contains(text, *words):
    """Checks that a text contains these words."""
    for word in words:
        if word not in text:
            raise Unexpected(f"no {word!r} in: {text[-800:]}")


class Chapter:
    """Steps in their order. One that fails ends its chapter, for the next ones build on it."""

    def __init__(self, name, end=lambda: None):
        self.name = name
        self.steps = []
        self.end = end
        self.at = ""

    def step(self, words):
        """Makes a function a step, told in these words."""

        def add(function):
            self.steps.append((words, function))
            return function

        return add

    def go(self, tell):
        """Goes through the steps; gives how many passed and which failed."""
        passed, failed = 0, None
        for words, function in self.steps:
            self.at = words
            begin = time.monotonic()
            slow = threading.Timer(120, tell, [f"...    {self.name}: {words}: still at it after 120 s"])
            slow.daemon = True
            slow.start()
            try:
                found = function()
            except Exception as error:  # a step may fail in any way, and the others are to be heard of
                kind = "" if isinstance(error, Unexpected) else f"{type(error).__name__}: "
                failed = f"{self.name}: {words}"
                tell(f"FAILED {failed}: {kind}{error}")
                break
            finally:
                slow.cancel()
            took = f"{time.monotonic() - begin:.0f} s"
            more = f" ({found}; {took})" if found else f" ({took})"
            tell(f"ok     {self.name}: {words}{more}")
            passed += 1
        self.at = "its end"
        try:
            self.end()
        except Exception as error:
            failed = failed or f"{self.name}: its end"
            tell(f"FAILED {self.name}: its end: {error}")
        self.at = ""
        return passed, failed
