"""A job of OpenCue: a layer that submits a scene to a farm and waits for its bake, and one of workers meanwhile.

    KILN_SERVER=http://farm:7410 python3 opencue_job.py SCENE [WORKERS]

Needs PyOutline. Hosts need 'kiln' on their path, and KILN_TOKEN with a token of the scopes 'submit' and 'worker'.
The frame that waits for the bake and those that work run at the same time: they need two hosts, or one with nine cores.
With less, the bake waits for workers that wait for its end.

The file's name is not that of OpenCue's own module, which Python would look for beside it.
"""

import os
import shlex
import sys

import outline
import outline.cuerun
from outline.modules.shell import Shell


def job(scene, server, workers):
    """The job; each worker is a frame."""
    made = outline.Outline("lightkiln", shot="bake", show="testing")
    bake = ["kiln", "submit", scene, "--server", server, "--wait"]
    # As texts: without PyOutline's wrapper, words are joined by spaces.
    made.add_layer(Shell("bake", command=shlex.join(bake), range="1", threads=1))
    work = ["kiln", "worker", "--server", server, "--threads", "8", "--exit-when-idle", "300"]
    made.add_layer(Shell("workers", command=shlex.join(work), range="1-%d" % workers, threads=8, memory="16g"))
    return made


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 4
    # Without the wrapper, hosts need no PyOutline of their own.
    outline.cuerun.launch(job(sys.argv[1], os.environ["KILN_SERVER"], count), use_pycuerun=False)
