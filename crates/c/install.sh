#!/usr/bin/env bash
# Builds lsdc for C and C++ and installs it: headers, shared and static library, pkg-config file, CMake package, licences.
#
#     crates/c/install.sh PREFIX
#
# With LSDC_BUILT set, installs what `cargo build --release` of the workspace has built. DESTDIR is prepended to PREFIX, as
# packagers expect. The installed files use relative paths, so they can be moved. For ELF systems such as Linux, and macOS.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
prefix="${1:?usage: install.sh PREFIX}"
into="${DESTDIR:-}$prefix"

cd "$root"
[ -n "${LSDC_BUILT:-}" ] || cargo build --release --locked -p lsdc-c
built="${CARGO_TARGET_DIR:-$root/target}/release"
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)
abi=$(sed -n 's/.*LSDC_ABI_VERSION: u32 = \([0-9]*\);/\1/p' "$here/src/abi.rs")

# The libraries listed by `rustc --print native-static-libs`.
case "$(uname)" in
  Darwin)
    ending=dylib file="liblsdc.$version.dylib" name="liblsdc.$abi.dylib" link=liblsdc.dylib
    system="-framework CoreFoundation -liconv -lSystem -lm" libraries="iconv;System;m" ;;
  *)
    ending=so file="liblsdc.so.$version" name="liblsdc.so.$abi" link=liblsdc.so
    system="-lgcc_s -lutil -lrt -lpthread -lm -ldl" libraries="gcc_s;util;rt;pthread;m;dl" ;;
esac

install -d "$into/include" "$into/lib/pkgconfig" "$into/lib/cmake/lsdc" "$into/share/doc/lsdc"
install -m 644 "$here/include/lsdc.h" "$here/include/lsdc.hpp" "$into/include"
install -m 644 "$here/LICENSE-APACHE" "$here/LICENSE-MIT" "$here/NOTICE" "$into/share/doc/lsdc"
install -m 644 "$built/liblsdc_c.a" "$into/lib/liblsdc.a"
install -m 755 "$built/liblsdc_c.$ending" "$into/lib/$file"
ln -sf "$file" "$into/lib/$name"
ln -sf "$name" "$into/lib/$link"

filled() {
  sed -e "s|@VERSION@|$version|g" -e "s|@SYSTEM@|$system|g" -e "s|@LIBRARIES@|$libraries|g" \
    -e "s|@FILE@|$file|g" -e "s|@NAME@|$name|g" "$1"
}
filled "$here/cmake/lsdc.pc.in" >"$into/lib/pkgconfig/lsdc.pc"
filled "$here/cmake/lsdc-config.cmake.in" >"$into/lib/cmake/lsdc/lsdc-config.cmake"
filled "$here/cmake/lsdc-config-version.cmake.in" >"$into/lib/cmake/lsdc/lsdc-config-version.cmake"
echo "lsdc $version (interface $abi) is in $into"
