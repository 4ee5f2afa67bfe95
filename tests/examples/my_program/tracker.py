"""A tracker as a program, in Python alone: every detection goes to the nearest track."""

import json
import math
import sys
import time

BOX = ("x", "y", "z", "length", "width", "height", "yaw")
COLUMNS = ("id", *BOX, "vx", "vy", "score", "label")


class Nearest:
    """Tracks with a steady velocity; a detection within `gate` m moves the nearest of its label."""

    def __init__(self, gate=4.0, patience=1.0, hits=3):
        self.gate = gate
        self.patience = patience  # seconds without a detection
        self.hits = hits  # detections before a track is reported
        self.tracks = []
        self.last = None
        self.ids = 0

    def step(self, now, frame):
        """Columns of detections at a time to columns of tracks."""
        dt = 0.0 if self.last is None else now - self.last
        self.last = now
        for track in self.tracks:
            track["x"] += dt * track["vx"]
            track["y"] += dt * track["vy"]
        scores = frame["score"]
        for row in sorted(range(len(scores)), key=lambda row: -scores[row]):
            self.take(now, {name: frame[name][row] for name in (*BOX, "label")})
        self.tracks = [track for track in self.tracks if now - track["seen"] <= self.patience]
        told = [track for track in self.tracks if track["hits"] >= self.hits]
        return {name: [track[name] for track in told] for name in COLUMNS}

    def take(self, now, box):
        nearest, shortest = None, self.gate
        for track in self.tracks:
            if track["seen"] < now and track["label"] == box["label"]:
                distance = math.hypot(track["x"] - box["x"], track["y"] - box["y"])
                if distance <= shortest:
                    nearest, shortest = track, distance
        if nearest is None:
            motion = {"vx": 0.0, "vy": 0.0, "hits": 1, "seen": now, "score": 0.5}
            self.tracks.append({"id": self.ids, **box, **motion, "at": (box["x"], box["y"])})
            self.ids += 1
            return
        elapsed = now - nearest["seen"]
        gain = 1.0 if nearest["hits"] == 1 else 0.2
        for speed, here, before in zip(("vx", "vy"), ("x", "y"), nearest["at"], strict=True):
            measured = (box[here] - before) / elapsed
            nearest[speed] += gain * (measured - nearest[speed])
        hits = nearest["hits"] + 1
        nearest.update(box, hits=hits, seen=now, at=(box["x"], box["y"]))
        nearest["score"] = min(0.5 + 0.1 * hits, 0.99)


def main():
    tracker = None
    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "start":
            tracker = Nearest(**message["parameters"])
            answer = {"type": "ready", "protocol": 1}
        else:
            start = time.perf_counter()
            tracks = tracker.step(message["time"], message)
            took = time.perf_counter() - start
            answer = {"type": "tracks", "step": message["step"], "seconds": took, **tracks}
        print(json.dumps(answer, allow_nan=False), flush=True)


if __name__ == "__main__":
    main()
