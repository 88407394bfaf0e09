#!/usr/bin/env bash
# Builds the machine from Debian's packages into .vm/:
#   vmlinux   the kernel, uncompressed (unpacking it inside an emulated processor is slow)
#   initrd    busybox and the modules that reach the root disk
#   root      Debian with systemd, and /opt/srvs-cell: a venv with what requirements.txt locks
#   stamp     what the above was made from: an equal stamp skips all but the last step
#   root.img  the machine's disk: root, and the project's wheel
# Exit 77: it cannot be had here (not Debian, not root, no network); the reason is on stdout.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=tests/vm/config.sh
. "$here/config.sh"

stamp=$({ cat "$here"/{build.sh,config.sh,lock_for_guest.py} "$here"/machine/* "$root/requirements.txt"; } | sha256sum | cut -d' ' -f1)
missing=()
for pair in "${host_tools[@]}"; do
	command -v "${pair%%:*}" >/dev/null || missing+=("${pair#*:}")
done

guest=$cache/root # the machine's files

# Installs the wheel as docs/how-to/install-service.md has it, by the guest's own Python, but at the speed of this
# processor; the service cannot write its byte code.
make_disk() {
	local wheel sum
	rm -rf "$cache/wheel"
	(cd "$root" && "$python" -m hatchling build --target wheel --directory "$cache/wheel" >"$cache/wheel.log" 2>&1) ||
		{ cat "$cache/wheel.log" && exit 1; }
	wheel=$(echo "$cache"/wheel/*.whl)
	sum=$(sha256sum "$wheel")
	[ "$(cat "$cache/disk" 2>/dev/null)" = "$sum" ] && return
	[ "$(id -u)" = 0 ] || skip "needs root to install the wheel in the machine."
	rm -f "$cache/disk" "$cache/root.img"
	cp "$wheel" "$guest"
	in_guest -m pip install --quiet --no-index --no-deps --force-reinstall --no-compile "/${wheel##*/}"
	rm "$guest/${wheel##*/}"
	in_guest -m compileall -q -j 0 -x '/tests/' /opt/srvs-cell/lib
	truncate -s "$(($(du -sm "$guest" | cut -f1) + 400))M" "$cache/root.img"
	mkfs.ext4 -q -F -m 0 -O '^has_journal' -d "$guest" "$cache/root.img"
	echo "$sum" >"$cache/disk"
}
in_guest() { env -i PATH="$PATH" chroot "$guest" /opt/srvs-cell/bin/python "$@"; }

if [ ${#missing[@]} = 0 ] && [ "$(cat "$cache/stamp" 2>/dev/null)" = "$stamp" ]; then
	make_disk
	exit 0
fi

# --- what must be so that it can be built -------------------------------------------------------------------------
[ "$(dpkg --print-architecture 2>/dev/null)" = amd64 ] || skip "needs Debian on amd64."
[ "$(id -u)" = 0 ] || skip "needs root to install packages and to build the machine's disk."
started=$SECONDS
apt-get -qq update || skip "Debian's packages cannot be reached."
# The mirror and the release are the host's own: apt knows them.
# shellcheck disable=SC2016  # apt fills these in
read -r suite mirror < <(apt-get indextargets --format '$(CODENAME) $(REPO_URI) $(COMPONENT)' \
	'Created-By: Packages' 'Origin: Debian' | awk '$3 == "main" && $1 !~ /-/ {print $1, $2; exit}') ||
	skip "apt knows no mirror of Debian."
if [ ${#missing[@]} -gt 0 ]; then
	DEBIAN_FRONTEND=noninteractive apt-get -qq -y --no-install-recommends \
		-o DPkg::Options::=--path-exclude='/usr/share/{doc,man}/*' install "${missing[@]}" >/dev/null 2>&1 ||
		skip "cannot install ${missing[*]}."
	say "installed ${missing[*]} (after $((SECONDS - started)) s)"
fi

mkdir -p "$cache"/{debs,archives,wheels}
rm -rf "$cache"/{stamp,disk,root}
# The work tree (about 1.5 GiB) goes to memory where there is enough of it.
base=${TMPDIR:-/var/tmp}
[ "$(df -m --output=avail /dev/shm 2>/dev/null | tail -1)" -gt 6000 ] 2>/dev/null && base=/dev/shm
w=$(mktemp -d "$base/srvs-vm.XXXXXX")
chmod 755 "$w"
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$w"' EXIT

# --- Debian, beside the two downloads below; its packages are kept for the next build --------------------------------
include=$(IFS=, && echo "${guest_packages[*]}")
mmdebstrap --quiet --mode=root --variant=minbase --include="$include" \
	--dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
	--dpkgopt='path-exclude=/usr/share/locale/*' \
	--skip=download/empty --skip=essential/unlink \
	--setup-hook="mkdir -p \"\$1\"/var/cache/apt/archives" \
	--setup-hook="cp -n $cache/archives/*.deb \"\$1\"/var/cache/apt/archives/ 2>/dev/null || true" \
	--customize-hook="cp -u \"\$1\"/var/cache/apt/archives/*.deb $cache/archives/" \
	"$suite" "$w/root" "$mirror" >"$w/root.log" 2>&1 &
debian=$!

# --- kernel: its package is unpacked, not installed ------------------------------------------------------------------
kernel_package=$(apt-cache depends "$kernel_meta" | awk '/Depends: linux-image-/ {print $2; exit}')
version=${kernel_package#linux-image-}
mkdir -p "$w/kernel" "$cache/debs/$kernel_package"
(cd "$cache/debs/$kernel_package" && apt-get -qq download "$kernel_package" 2>/dev/null) ||
	skip "$kernel_package cannot be fetched."
dpkg-deb --fsys-tarfile "$cache/debs/$kernel_package"/*.deb | tar -x -C "$w/kernel" ./boot ./lib/modules
"$python" "$here/uncompressed_kernel.py" "$w/kernel/boot/vmlinuz-$version" "$cache/vmlinux"
depmod -b "$w/kernel" "$version"

# The modules' files in the order in which they load, without those built in.
module_files() {
	local module
	for module; do
		modprobe -d "$w/kernel" -S "$version" --ignore-install --show-depends "$module"
	done | awk '$1 == "insmod" && !seen[$2]++ {sub(/^.*\/lib\/modules\//, "lib/modules/", $2); print $2}'
}

mkdir -p "$w/initrd/bin"
cp "$(command -v busybox)" "$w/initrd/bin/busybox"
ln -s busybox "$w/initrd/bin/sh"
install -m 755 "$here/machine/init" "$w/initrd/init"
module_files "${boot_modules[@]}" >"$w/initrd/modules.order"
(cd "$w/kernel" && cpio -pdm --quiet "$w/initrd" <"$w/initrd/modules.order")
(cd "$w/initrd" && find . | cpio -o -H newc --quiet) >"$cache/initrd"
say "kernel $version (after $((SECONDS - started)) s)"

# --- what requirements.txt locks, for the guest's Python --------------------------------------------------------------
guest_python=$(apt-cache show python3 | sed -n 's/^Version: \([0-9]*\.[0-9]*\).*/\1/p' | head -1)
"$python" "$here/lock_for_guest.py" "$guest_python" "$root/requirements.txt" >"$w/lock.txt"
"$python" -m pip download --quiet --no-deps --require-hashes -r "$w/lock.txt" -d "$cache/wheels" --find-links "$cache/wheels" \
	--only-binary=:all: --implementation cp --python-version "$guest_python" --abi "cp${guest_python/./}" --abi abi3 --abi none \
	--platform manylinux_2_28_x86_64 --platform manylinux_2_27_x86_64 --platform manylinux_2_17_x86_64 \
	--platform manylinux2014_x86_64 >"$w/pip.log" 2>&1 || { cat "$w/pip.log" && skip "the Python packages cannot be fetched."; }
say "Python packages (after $((SECONDS - started)) s)"

wait "$debian" || { cat "$w/root.log" >&2; exit 1; }
mv "$w/root" "$guest"
mkdir "$guest/wheels"
cp "$w/lock.txt" "$guest/wheels/"
ln -f "$cache"/wheels/*.whl "$guest/wheels/"
env -i PATH="$PATH" chroot "$guest" python3 -m venv /opt/srvs-cell
in_guest -m pip install --quiet --no-compile --no-index --find-links /wheels --require-hashes -r /wheels/lock.txt
rm -rf "$guest/wheels"
say "Debian $suite with /opt/srvs-cell (after $((SECONDS - started)) s)"

{ module_files "${modules[@]}" && cat "$w/initrd/modules.order"; } | sort -u >"$w/modules"
(cd "$w/kernel" && { cat "$w/modules" && ls lib/modules/"$version"/modules.{builtin,builtin.modinfo,order}; } | cpio -pdm --quiet "$guest/usr")
depmod -b "$guest" "$version"
install -m 755 "$here/machine/bench-job" "$guest/usr/local/sbin/"
install -m 644 "$here"/machine/bench.{service,target} "$guest/etc/systemd/system/"
mkdir -p "$guest/etc/systemd/system/bench.target.wants"
ln -s ../bench.service "$guest/etc/systemd/system/bench.target.wants/"
ln -sf /etc/systemd/system/bench.target "$guest/etc/systemd/system/default.target"
# Work at boot that a throw-away machine does not need.
while read -r unit; do
	ln -sf /dev/null "$guest/etc/systemd/system/$unit"
done <"$here/machine/masked-units"
echo cell-pc >"$guest/etc/hostname"
echo 127.0.0.1 localhost cell-pc >"$guest/etc/hosts"
# A fixed machine id keeps systemd from taking this for a first boot.
echo 0123456789abcdef0123456789abcdef >"$guest/etc/machine-id"
mkdir -p "$guest/etc/systemd/journald.conf.d"
printf '[Journal]\nStorage=volatile\nRateLimitBurst=0\n' >"$guest/etc/systemd/journald.conf.d/bench.conf"
: >"$guest/etc/fstab"
rm -rf "$guest"/var/cache/apt/* "$guest"/var/lib/apt/lists/*

make_disk
echo "Debian $suite, kernel $version, Python $guest_python" >"$cache/description"
echo "$stamp" >"$cache/stamp"
say "machine built in $((SECONDS - started)) s"
