"""`make dependencies`: what is installed fits together, and has no vulnerability that is known of.

Known vulnerabilities are OSV's (osv.dev), asked over the network; where that cannot be reached, nothing is audited, and
this is said.
"""

from __future__ import annotations

import socket
import subprocess
import sys

from pipelines.cli.console import Console

SERVICE = ("api.osv.dev", 443)
SECONDS = 5.0
"""How long the service may take to answer at all."""


def main() -> int:
    """Exit status: 0 if nothing is wrong, or nothing could be asked."""
    if subprocess.run([sys.executable, "-m", "pip", "check"], check=False).returncode:
        return 1
    try:
        socket.create_connection(SERVICE, SECONDS).close()
    except OSError as error:
        Console().say(f"not audited: {SERVICE[0]} cannot be reached ({error})")
        return 0
    # ours is installed from its folder, and not on an index
    audit = ["-m", "pip_audit", "--vulnerability-service", "osv", "--skip-editable", "--progress-spinner", "off"]
    return subprocess.run([sys.executable, *audit], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
