"""Looks up every pinned dependency in the advisories that pip-audit knows; says so where these cannot be reached.

python .ci/audit.py PIP_AUDIT        exit status 1 where a known vulnerability was found
"""

import json
import subprocess
import sys


def main() -> int:
    """Run pip-audit on constraints.txt, and report."""
    command = [sys.argv[1], "--requirement", "constraints.txt", "--no-deps", "--disable-pip", "--format", "json"]
    done = subprocess.run([*command, "--progress-spinner", "off"], capture_output=True, text=True, check=False)
    try:
        found = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError):
        reason = (done.stderr.strip() or "no output").splitlines()[-1]
        print(f"== audit: skipped, the advisories cannot be reached: {reason}")
        return 0
    skipped = [one for one in found if "skip_reason" in one]
    bad = [(one, vulnerability) for one in found for vulnerability in one.get("vulns", [])]
    for one, vulnerability in bad:
        fixed = ", ".join(vulnerability["fix_versions"]) or "none yet"
        print(f"== audit: {one['name']} {one['version']}: {vulnerability['id']}, mended in {fixed}")
    if len(skipped) == len(found):
        print(f"== audit: skipped, none of {len(found)} dependencies could be looked up: {skipped[0]['skip_reason']}")
    else:
        print(
            f"== audit: {len(found) - len(skipped)} of {len(found)} dependencies looked up, {len(bad)} vulnerabilities"
        )
    return min(1, len(bad))


if __name__ == "__main__":
    sys.exit(main())
