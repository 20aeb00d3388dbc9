"""Make an SROS 2 keystore for the nodes of a configuration.

Each node gets an enclave with only the permissions that it needs. /person is for operators, /watch
may only subscribe. Existing keys are kept: run it again when nodes change.
"""

import argparse
import os
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

from fss_policies import ACCESS, OPERATOR, Access, governance, permissions

VALIDITY = 3650  # of certificates [days]
CURVE = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


def openssl(*arguments: str | Path) -> None:
    """Run openssl.

    Raises:
        OSError: openssl is missing, or fails.
    """
    done = subprocess.run(["openssl", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no reason given"]
        raise OSError(f"openssl {arguments[0]}: {lines[-1]}")


class Keystore:
    """Folder with enclaves, and the authority's key in private/, needed to make enclaves only."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder, self.domain = folder, domain
        self.certificate = folder / "public/ca.cert.pem"
        self.key = folder / "private/ca.key.pem"
        for name in ("public", "private", "enclaves"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / "private").chmod(0o700)
        if not self.key.exists():
            openssl(
                "req",
                "-x509",
                *CURVE,
                "-keyout",
                self.key,
                "-out",
                self.certificate,
                "-days",
                str(VALIDITY),
                "-subj",
                "/CN=fss_arm",
            )
        now = datetime.now(UTC)
        times = now - timedelta(days=1), now + timedelta(days=VALIDITY)
        self.valid = times[0].strftime("%Y-%m-%dT%H:%M:%S"), times[1].strftime("%Y-%m-%dT%H:%M:%S")
        self.governance = folder / "enclaves/governance.p7s"
        self.sign(governance(domain), self.governance)

    def sign(self, text: str, signed: Path) -> None:
        """Write a document, and a signed copy beside it."""
        plain = signed.with_suffix(".xml")
        plain.write_text(text, encoding="utf-8")
        openssl(
            "smime",
            "-sign",
            "-text",
            "-in",
            plain,
            "-out",
            signed,
            "-signer",
            self.certificate,
            "-inkey",
            self.key,
        )

    def enclave(self, name: str, access: Access, namespace: str = "") -> None:
        """Make an enclave, or give it new permissions."""
        folder = self.folder / "enclaves" / name.lstrip("/")
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "cert.pem").exists():
            with TemporaryDirectory() as temporary:
                request, subject = Path(temporary, "csr.pem"), name.replace("/", "\\/")
                openssl(
                    "req",
                    *CURVE,
                    "-keyout",
                    folder / "key.pem",
                    "-out",
                    request,
                    "-subj",
                    f"/CN={subject}",
                )
                openssl(
                    "x509",
                    "-req",
                    "-in",
                    request,
                    "-CA",
                    self.certificate,
                    "-CAkey",
                    self.key,
                    "-set_serial",
                    str(int.from_bytes(os.urandom(8), "big")),
                    "-days",
                    str(VALIDITY),
                    "-out",
                    folder / "cert.pem",
                )
        for link in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
            self.link(folder / link, self.certificate)
        self.link(folder / "governance.p7s", self.governance)
        document = permissions(name, access, self.domain, self.valid, namespace)
        self.sign(document, folder / "permissions.p7s")

    @staticmethod
    def link(path: Path, to: Path) -> None:
        """Make a relative link, so that the keystore can be copied as a whole."""
        path.unlink(missing_ok=True)
        path.symlink_to(os.path.relpath(to, path.parent))


def main() -> int:
    """Run; return 1 if the keystore cannot be made."""
    parser = argparse.ArgumentParser("fss_security.sh", description=__doc__)
    parser.add_argument("keystore", type=Path, help="folder of the keystore")
    parser.add_argument("name", help="name of the configuration")
    parser.add_argument("nodes", nargs="*", help="[NAMESPACE/]NAME=PACKAGE EXECUTABLE")
    given = parser.parse_args()
    os.umask(0o077)
    try:
        keystore = Keystore(given.keystore, int(os.environ.get("ROS_DOMAIN_ID", "0")))
        keystore.enclave("/person", OPERATOR)
        keystore.enclave("/watch", Access())
        for node in given.nodes:
            name, _, what = node.partition("=")
            if what not in ACCESS:
                print(f"{name}: may only subscribe, as no permissions are defined for {what}")
            space = name.rpartition("/")[0]
            keystore.enclave(f"/{given.name}/{name}", ACCESS.get(what, Access()), space)
    except (OSError, ValueError) as error:
        print(f"fss_security.sh: {error}", file=sys.stderr)
        return 1
    place = given.keystore.resolve()
    print(f"{len(given.nodes) + 2} enclaves for domain {keystore.domain} in {place}; to use them:")
    print(f"export ROS_SECURITY_KEYSTORE={place}")
    print("export ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce")
    return 0


if __name__ == "__main__":
    sys.exit(main())
