#!/usr/bin/env bash
# In the guest: sets the service up as docs/how-to/install-service.md has it, then runs the checks with its Python.
# The wheel and what requirements.txt locks are in the machine's image already.
set -euo pipefail
job=$1

started=$SECONDS
ln -s /opt/srvs-cell/bin/srvs-cell /usr/local/bin/srvs-cell
data=$(echo /opt/srvs-cell/lib/python3*/site-packages/srvs_cell/_data/systemd)
install -D -m 644 "$data"/srvs-cell.sysusers /etc/sysusers.d/srvs-cell.conf
systemd-sysusers
install -d -m 750 -g srvs-cell /etc/srvs-cell
install -m 644 "$data"/srvs-cell.service /etc/systemd/system/
systemctl daemon-reload

echo "ok     $(printf %5.1f $((SECONDS - started))) s  install: user, unit file"
cd "$job"
# As in the service's unit file: how long a frozen camera may hold OpenCV.
export OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT=2 OPENCV_LOG_LEVEL=ERROR
exec /opt/srvs-cell/bin/python -m tests.vm.checks "$job/cell"
