"""A tracker as a program that reports its detections, and goes wrong at step 2 as it is told."""

import json
import os
import signal
import subprocess
import sys
import time

COLUMNS = ("x", "y", "z", "length", "width", "height", "yaw", "score", "label")


def tell(answer):
    print(json.dumps(answer), flush=True)


def tracks(message):
    n = len(message["x"])
    columns = {name: message[name] for name in COLUMNS}
    moves = {"id": list(range(n)), "vx": [0.0] * n, "vy": [0.0] * n}
    return {"type": "tracks", "step": message["step"], **columns, **moves}


def go_wrong(how, answer):
    print(f"about to {how}", file=sys.stderr, flush=True)
    if how == "exit":
        sys.exit(3)
    elif how == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif how in ("hang", "children"):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(1)
    elif how == "late":
        time.sleep(0.8)
        tell(answer)
    elif how == "close":
        os.close(1)
        time.sleep(60)
    elif how == "flood":
        while True:
            os.write(1, b"0" * 65536)
    elif how == "twice":
        os.write(1, 2 * (json.dumps(answer) + "\n").encode())
    elif how == "astray":
        os.write(1, f"42 boxes left\n{json.dumps(answer)}\n".encode())
    elif how == "behind":
        tell({**answer, "step": answer["step"] - 1})
    elif how == "nan":
        tell({**answer, "x": [float("nan")] * len(answer["x"])})
    elif how == "null":
        tell({**answer, "y": [None] * len(answer["y"])})
    elif how == "text":
        tell({**answer, "yaw": ["0.1"] * len(answer["yaw"])})
    elif how == "huge":
        os.write(1, json.dumps(answer).replace('"vx": [0.0', '"vx": [1e999').encode() + b"\n")
    elif how == "short":
        tell({**answer, "z": answer["z"][1:]})
    elif how == "missing":
        tell({name: values for name, values in answer.items() if name != "score"})
    elif how == "unknown":
        tell({**answer, "velocity": []})
    elif how == "same-id":
        tell({**answer, "id": [0] * len(answer["id"])})
    elif how == "negative-id":
        tell({**answer, "id": [-1 - i for i in answer["id"]]})
    elif how == "flat":
        tell({**answer, "height": [0.0] * len(answer["height"])})
    elif how == "no-label":
        tell({**answer, "label": ["van"] * len(answer["label"])})
    elif how == "words":
        print("tracks: none", flush=True)
    elif how == "list":
        tell([answer])
    else:
        raise AssertionError(how)


def main():
    how = sys.argv[1]
    if how == "banner":
        print("odd program 1.0", flush=True)
    if how == "children":
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "start":
            protocol = 2 if how == "protocol" else 1
            print(f"seed {message['seed']}, process {os.getpid()}", file=sys.stderr)
            tell({"type": "ready", "protocol": protocol})
            if how == "early":
                tell({"type": "ready", "protocol": protocol})
            continue
        answer = tracks(message)
        if how == "chatter":
            os.write(2, b"x" * 79 + b"\n" + b"chatter\n" * 100_000)
        if message["step"] == 2 and how not in ("well", "chatter"):
            go_wrong(how, answer)
        else:
            tell(answer)


main()
