"""Frames that kill their worker, because of a bug in a library or a lack of memory.

Ray retries a task whenever its worker dies, which is right unless the task is the cause. A retried shard therefore
records its current frame, and gives up a frame at which workers have died several times.
"""

from __future__ import annotations

import json
from collections import Counter

from ._options import as_text
from ._place import SCRATCH, Place

# Deaths at the same frame after which it is given up, not counting the first death of its shard, whose frame is unknown.
# Workers also die of other causes: with 3, the kill test gave up a sound frame.
GIVEN_UP = 8


class Attempts:
    """Earlier attempts at a shard."""

    def __init__(self, place: Place, shard: str) -> None:
        self._place, self._file = place, f"{SCRATCH}/{shard}.json"
        self._again = place.is_file(self._file)
        self._deaths = Counter[str]()
        if self._again:
            note = json.loads(place.read(self._file))
            self._deaths.update(note["deaths"])
            if note["at"] is not None:
                self._deaths[note["at"]] += 1
        self.pause()

    def begin(self, key: str) -> str | None:
        """Records the current frame, or returns the reason why it is given up."""
        deaths = self._deaths[key]
        if deaths >= GIVEN_UP:
            return f"{deaths} workers died while they completed it"
        if self._again:
            self._note(key)
        return None

    def pause(self) -> None:
        """Records that no frame is in progress."""
        self._note(None)

    def _note(self, key: str | None) -> None:
        self._place.write(self._file, as_text({"at": key, "deaths": dict(self._deaths)}).encode())
