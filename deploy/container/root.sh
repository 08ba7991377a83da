#!/bin/sh
# Lays out the image: `root.sh BINARY FOLDER`. Into FOLDER/root go the binary, stripped, the libraries that it is linked to, and empty folders for
# configuration and temporary files (names are resolved by glibc itself, so nothing else is needed); into FOLDER/data an empty folder for what
# a part keeps, which is to be its user's.
set -eu
binary=$1
root=$2/root
mkdir -p "$root/etc/zenav" "$root/tmp" "$2/data/zenav"
chmod 1777 "$root/tmp"
strip -o "$root/zenav" "$binary"
chmod 755 "$root/zenav"
ldd "$binary" | grep -o '/[^ ]*' | while read -r library; do
    mkdir -p "$root$(dirname "$library")"
    cp -L "$library" "$root$library"
done
