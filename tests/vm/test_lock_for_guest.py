"""What is installed in the virtual machine is what is locked for its Python, not for the host's."""

from tests.vm.lock_for_guest import lock_for

_LOCK = """\
# made by a resolver
numpy==2.4.6 ; python_full_version < '3.12' \\
    --hash=sha256:aa \\
    --hash=sha256:bb
numpy==2.5.5 ; python_full_version >= '3.12' \\
    --hash=sha256:cc
colorama==0.4.6 ; sys_platform == 'win32' \\
    --hash=sha256:dd
idna==3.20 \\
    --hash=sha256:ee
"""


def test_markers_are_those_of_the_guest() -> None:
    old = "numpy==2.4.6 \\\n    --hash=sha256:aa \\\n    --hash=sha256:bb\n"
    new = "numpy==2.5.5 \\\n    --hash=sha256:cc\n"
    plain = "idna==3.20 \\\n    --hash=sha256:ee\n"
    assert lock_for("3.11", _LOCK) == old + plain
    assert lock_for("3.13", _LOCK) == new + plain
