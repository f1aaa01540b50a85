"""Hulls for the evaluation of person tracking: scenes rendered, segmented from their pictures and carved.

    python -m eval.tracking_scenes                    # all scenes: some three minutes each, 20 in all
    python -m eval.tracking_scenes meeting_01 sit     # these ones

Works scene by scene and leaves finished ones alone, so that it can be stopped and begun again at any time. Hulls at
2, 5, 10 and 15 cm (2 cm alone where the rest is not needed) and the truth go to out/tracking. The long scenes are
silhouettes without shading.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from eval.tracking import hulls


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is not made yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="scene names; none = all of the evaluation")
    parser.add_argument("--work", type=Path, default=hulls.WORK)
    chosen = parser.parse_args(arguments)
    others = tuple(name for name in hulls.OTHERS if (hulls.SHARED / name).is_dir())
    small = (*hulls.SMALL_DEVELOPMENT, *hulls.SMALL_TEST, *hulls.LOW_DEVELOPMENT, *hulls.LOW_TEST)
    more = (*others, *hulls.THREE_DEVELOPMENT, *hulls.THREE_TEST, *hulls.LONG_DEVELOPMENT, *hulls.LONG_TEST)
    scenes = chosen.scenes or [*hulls.DEVELOPMENT, *hulls.TEST, *small, *more]
    for scene in scenes:
        started = time.perf_counter()
        sizes = hulls.VOXEL_CM if scene in (*hulls.DEVELOPMENT, *hulls.TEST) else (2,)
        hulls.make_hulls(scene, sizes, chosen.work)
        print(f"{scene}: {time.perf_counter() - started:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
