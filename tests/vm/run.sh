#!/usr/bin/env bash
# `make test-vm`: builds the machine where that is due, boots it, runs tests/vm/checks in it, and the simulated robot
# beside it. Prints one line a check; exits 1 where one failed or all together take too long, 0 where it says plainly
# that it was skipped.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=tests/vm/config.sh
. "$here/config.sh"
readonly limit_s=900

started=$SECONDS
left_s() { echo $((started + limit_s - SECONDS)); }
too_long() { say "failed: not finished within $limit_s s; is this machine very busy?"; }

code=0
timeout --kill-after=10 "$(left_s)" "$here/build.sh" || code=$?
[ "$code" = "$skipped" ] && exit 0
[ "$code" = 124 ] && too_long
[ "$code" = 0 ] || exit "$code"
built=$((SECONDS - started))

w=$(mktemp -d)
children=()
# Ends only what was started here.
# shellcheck disable=SC2317  # called by the trap
cleanup() {
	kill "${children[@]}" 2>/dev/null || true
	wait
	mkdir -p "$cache/last-run"
	cp "$w"/job/{log,journal} "$w"/{console,qemu.log,robot.log} "$cache/last-run/" 2>/dev/null || true
	rm -rf "$w"
}
trap cleanup EXIT

# --- what the machine is given: the checks, where the robot is ------------------------------------------------------
job=$w/job
mkdir -p "$job/cell" "$job/tests"
cp "$root/tests/__init__.py" "$job/tests/"
cp -r "$here" "$job/tests/vm"

timeout "$(left_s)" "$root/.venv/bin/srvs-cell" sim --objects 1 --folder "$job/cell" >"$w/listens.json" 2>"$w/robot.log" &
children+=($!)
until [ -s "$w/listens.json" ]; do
	kill -0 "${children[0]}" || { cat "$w/robot.log" && exit 1; }
	sleep 0.2
done
cp "$w/listens.json" "$job/cell/listens.json"

# --- the machine ----------------------------------------------------------------------------------------------------
# /dev/kvm alone says nothing: where the processor shows neither VMX nor SVM, KVM is many times slower than emulation.
# Emulated, a plain processor is quicker than one with wide vectors; numpy asks for what this one has.
machine=(-M "q35,accel=tcg" -cpu Nehalem)
if [ -w /dev/kvm ] && grep -qwE 'vmx|svm' /proc/cpuinfo; then
	machine=(-M "q35,accel=kvm" -cpu host)
fi
append="console=ttyS0 quiet panic=-1 mitigations=off nokaslr random.trust_cpu=on audit=0 selinux=0 apparmor=0
	systemd.show_status=0 systemd.log_target=journal net.ifnames=0 tsc=reliable no_timer_check 8250.nr_uarts=1
	cryptomgr.notests rcupdate.rcu_expedited=1 norandmaps"
timeout "$(left_s)" qemu-system-x86_64 "${machine[@]}" -smp 2 -m 1024 -nodefaults -display none -no-reboot \
	-kernel "$cache/vmlinux" -initrd "$cache/initrd" -append "${append//[$'\n\t']/ }" \
	-serial "file:$w/console" -device virtio-rng-pci \
	-drive "if=none,id=root,file=$cache/root.img,format=raw,snapshot=on,cache=unsafe" -device virtio-blk-pci,drive=root \
	-netdev user,id=net -device virtio-net-pci,netdev=net,romfile= \
	-virtfs "local,path=$job,mount_tag=job,security_model=none,multidevs=remap" >"$w/qemu.log" 2>&1 &
qemu=$!
children+=("$qemu")
say "$(cat "$cache/description"), ${machine[1]}"

touch "$job/log"
tail --follow --sleep-interval=0.5 --lines=+1 --pid="$qemu" "$job/log" &
children+=($!)
ended=0
wait "$qemu" || ended=$?
sleep 1 # for tail's last lines

code=$(cat "$job/code" 2>/dev/null || echo none)
if [ "$code" = none ]; then
	if [ "$ended" = 124 ]; then too_long; else say "failed: the machine ended without a result"; fi
	say "the console ends:"
	cat "$w/qemu.log"
	tail -n 30 "$w/console"
	code=1
fi
say "build $built s, boot $(cat "$job/booted-after-s" 2>/dev/null || echo '?') s, whole $((SECONDS - started)) s; logs in .vm/last-run"
exit "$code"
