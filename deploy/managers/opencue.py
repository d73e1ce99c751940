"""A job of OpenCue: a layer that submits a scene to a farm and waits for its bake, and one of workers meanwhile.

    KILN_SERVER=http://farm:7410 python3 opencue.py SCENE [WORKERS]

Needs PyOutline. Hosts need 'kiln' on their path, and KILN_TOKEN with a token of the scopes 'submit' and 'worker'.
"""

import os
import sys

import outline
import outline.cuerun
from outline.modules.shell import Shell


def job(scene, server, workers):
    """The job; each worker is a frame."""
    made = outline.Outline("lightkiln", shot="bake", show="testing")
    bake = ["kiln", "submit", scene, "--server", server, "--wait"]
    made.add_layer(Shell("bake", command=bake, range="1", threads=1))
    work = ["kiln", "worker", "--server", server, "--threads", "8", "--exit-when-idle", "300"]
    made.add_layer(Shell("workers", command=work, range="1-%d" % workers, threads=8, memory="16g"))
    return made


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 4
    outline.cuerun.launch(job(sys.argv[1], os.environ["KILN_SERVER"], count))
