# What the machine is made of; sourced by run.sh and build.sh.
# shellcheck shell=bash disable=SC2034  # used by those who source this file

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# Everything slow to make or to fetch is kept here (git ignores it).
cache=$root/.vm
python=$root/.venv/bin/python

# Host: program:package.
host_tools=(qemu-system-x86_64:qemu-system-x86 mmdebstrap:mmdebstrap busybox:busybox-static modprobe:kmod
	mkfs.ext4:e2fsprogs cpio:cpio)
# The meta package that names the kernel. The "-cloud" flavour has no media drivers.
kernel_meta=linux-image-amd64
# On top of Debian's minbase.
guest_packages=(systemd systemd-sysv udev kmod python3 python3-venv v4l-utils iproute2)
# Before the root file system is there; then what the bench uses.
boot_modules=(virtio_pci virtio_blk crc32c_generic ext4)
modules=(vivid uvcvideo vhci-hcd virtio_net virtio_rng 9p 9pnet_virtio autofs4)

# Nothing is wrong with the project, but the bench cannot run here.
readonly skipped=77
say() { printf 'test-vm: %s\n' "$*"; }
skip() {
	say "skipped: $*"
	exit "$skipped"
}
PATH=$PATH:/usr/sbin:/sbin
