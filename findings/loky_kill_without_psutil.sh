#!/usr/bin/env bash
# Package: loky 3.7.0.
# Expected: executor.shutdown(kill_workers=True) ends the workers, whatever else is installed: psutil is an optional
#   dependency of loky.
# Seen: without psutil and without pgrep (as in slim containers), or where pgrep is ended by the same signal, the way out
#   is process.kill(), which loky's own Popen does not have: AttributeError: 'Popen' object has no attribute 'kill',
#   as a traceback of the executor's thread, and the worker lives on.
# Why it matters: an interrupted run leaves its workers behind; install psutil beside loky.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq loky==3.7.0 cloudpickle==3.1.2
cat > "$work/try.py" <<'PY'
import os, time, signal
from loky import ProcessPoolExecutor

if __name__ == "__main__":
    os.environ["PATH"] = "/nonexistent"
    pool = ProcessPoolExecutor(max_workers=1)
    worker = pool.submit(os.getpid).result()
    pool.submit(time.sleep, 30)
    time.sleep(1)
    pool.shutdown(wait=True, kill_workers=True)
    try:
        os.kill(worker, 0)
    except ProcessLookupError:
        raise SystemExit("the worker is gone: the behaviour has changed") from None
    print("the worker lives on")
    os.kill(worker, signal.SIGKILL)
PY
"$work/venv/bin/python" -W ignore "$work/try.py" 2> "$work/err" | grep "lives on"
grep "'Popen' object has no attribute 'kill'" "$work/err"
