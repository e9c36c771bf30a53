#!/bin/bash
# Creates the root of the image: `root.sh PROGRAM FOLDER` copies the program, the libraries that it loads, and the licences.
set -euo pipefail
program=$1 folder=$2
licences=$(dirname "$0")/..

install -D -m 755 -s "$program" "$folder/usr/bin/lsdc"
# Each library is copied to the path where the loader looks for it.
ldd "$program" | grep -o '/[^ ]*' | while read -r library; do
  install -D -m 755 "$library" "$folder$library"
done
install -D -m 644 -t "$folder/usr/share/doc/lsdc" "$licences/LICENSE-MIT" "$licences/LICENSE-APACHE" "$licences/NOTICE"
# Names of users only: `--user` may be any id.
install -d -m 755 "$folder/etc"
echo 'lsdc:x:65532:65532::/:/usr/sbin/nologin' >"$folder/etc/passwd"
echo 'lsdc:x:65532:' >"$folder/etc/group"
