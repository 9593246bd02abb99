#!/bin/bash
# Boots systemd in a copy of this machine in memory, and runs FOLDER/inside.sh there as root.
#
#     booted.sh FOLDER PLACE=PATH...
#
# FOLDER is /shared inside, and keeps what inside.sh writes; each PATH is at /opt/PLACE. Nothing
# else is kept, and the processes see no network and no process of this machine. Needs root.
set -euo pipefail
if [[ ${1-} != --inside ]]; then
    own=()
    clean() { for each in "${own[@]}"; do find "$each" -depth -type d -exec rmdir {} \; ; done; }
    trap clean EXIT
    for tree in /sys/fs/cgroup /sys/fs/cgroup/systemd /sys/fs/cgroup/unified; do
        [[ -e $tree/cgroup.procs ]] || continue
        mkdir "$tree/pqsec-$$"
        own+=("$tree/pqsec-$$")
    done
    for each in "${own[@]}"; do printf 'echo $$ > %q/cgroup.procs\n' "$each"; done |
        cat - <(printf 'exec "$@"\n') > "$1/enter.sh"
    timeout -k 5 240 bash "$1/enter.sh" unshare --mount --pid --fork --ipc --uts --net --cgroup \
        --kill-child bash "$0" --inside "$@"
    exit
fi
shared=$(realpath "$2")
copy=/mnt
mount --make-rprivate /
mount -t tmpfs tmpfs "$copy"
mkdir "$copy/new" "$copy/work" "$copy/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$copy/new,workdir=$copy/work" "$copy/root"
root=$copy/root
mkdir "$root/shared"
mount --bind "$shared" "$root/shared"
for each in "${@:3}"; do
    mkdir -p "$root/opt/${each%%=*}"
    mount --bind "${each#*=}" "$root/opt/${each%%=*}"
done
mount -t proc proc "$root/proc"
mount --bind "$root/proc/sys" "$root/proc/sys"
mount -o remount,bind,ro "$root/proc/sys" # they are this machine's
mount -t sysfs -o ro sysfs "$root/sys"
for each in run tmp dev; do mount -t tmpfs -o mode=755 tmpfs "$root/$each"; done
chmod 1777 "$root/tmp"
for each in null zero full random urandom tty; do
    touch "$root/dev/$each"
    mount --bind "/dev/$each" "$root/dev/$each"
done
mkdir "$root/dev/pts" "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx" # PrivateDevices wants it
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
if [[ -e /sys/fs/cgroup/cgroup.procs ]]; then
    mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
else
    mount -t tmpfs -o mode=755 tmpfs "$root/sys/fs/cgroup"
    mkdir "$root/sys/fs/cgroup/systemd"
    mount -t cgroup -o none,name=systemd,xattr cgroup "$root/sys/fs/cgroup/systemd"
fi
cat > "$root/etc/systemd/system/inside.service" << 'END'
[Service]
Type=oneshot
ExecStart=/bin/bash /shared/inside.sh
StandardOutput=file:/shared/out
StandardError=inherit
ExecStopPost=/bin/sh -c 'journalctl --no-pager > /shared/journal; systemctl poweroff --force --force'
END
cd "$root" # a chroot would not do: services with namespaces of their own start from the real root
mkdir before
pivot_root . before
umount -l before
mount --make-rshared / # as on a machine: credentials reach a service by it
exec env -i container=pqsec PATH=/usr/sbin:/usr/bin:/sbin:/bin chroot . \
    /lib/systemd/systemd --system --unit=inside.service --show-status=0
