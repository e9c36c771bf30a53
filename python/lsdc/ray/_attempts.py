"""Frames that kill their worker: by a fault of a library, or by more memory than there is.

Ray tries a task again whenever its worker died, which is right unless it dies of the task. So a shard that is tried
again keeps a note of the frame that it is at, and a frame at which workers died several times is given up.
"""

from __future__ import annotations

import json
from collections import Counter

from ._options import as_text
from ._place import SCRATCH, Place

# Deaths at the same frame, beyond the first of its shard, of which it is not known where it was. Workers also die of
# other causes: with 3, the kill test gave up a frame of which nothing had died.
GIVEN_UP = 8


class Attempts:
    """What is known of earlier attempts at a shard."""

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
        """Keeps a note of a frame, unless it is given up: then says why."""
        deaths = self._deaths[key]
        if deaths >= GIVEN_UP:
            return f"{deaths} workers died while they completed it"
        if self._again:
            self._note(key)
        return None

    def pause(self) -> None:
        """At no frame."""
        self._note(None)

    def _note(self, key: str | None) -> None:
        self._place.write(self._file, as_text({"at": key, "deaths": dict(self._deaths)}).encode())
