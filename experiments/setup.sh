# Sourced by experiments/run and tests/run: brings the machine and the build up to date, and says
# nothing when there is nothing to do. Needs `root`, the folder of the repository.
# Defines setup, which takes the CMake targets to build (none = all).

packages=(
    g++ cmake ninja-build ccache git
    libtinygltf-dev libeigen3-dev catch2 libbenchmark-dev libtomlplusplus-dev libcli11-dev
    nlohmann-json3-dev libfmt-dev libtbb-dev libhwy-dev libxxhash-dev libstb-dev
    libopenvdb-dev libnanovdb-dev libboost-iostreams-dev libboost-dev
    glmark2-data assimp-testmodels
)

fail() {
    echo "$(basename "$0"): error: $*" >&2
    exit 2
}

missing_packages() {
    # Prints the names of those that are not installed; dpkg-query does not know others at all.
    local installed
    installed=$(dpkg-query -W -f '${db:Status-Status} ${Package}\n' "${packages[@]}" 2>/dev/null |
        sed -n 's/^installed //p')
    comm -23 <(printf '%s\n' "${packages[@]}" | sort) <(echo "$installed" | sort)
}

install_packages() {
    command -v dpkg-query >/dev/null || return 0 # not Debian: CMake says what is missing
    local missing
    mapfile -t missing < <(missing_packages)
    [ ${#missing[@]} -eq 0 ] && return 0
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null ||
            fail "missing packages, and neither root nor sudo to install them: ${missing[*]}"
        as_root=(sudo)
    fi
    echo "Installing: ${missing[*]}" >&2
    local log
    log=$(mktemp)
    if ! { "${as_root[@]}" apt-get update &&
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get install -y --no-install-recommends "${missing[@]}"; } >"$log" 2>&1; then
        tail -n 5 "$log" >&2
        rm -f "$log"
        fail "cannot install packages: ${missing[*]}"
    fi
    rm -f "$log"
}

configure_and_build() {
    local build="$root/build/release" log
    local targets=("$@")
    [ ${#targets[@]} -eq 0 ] && targets=(all)
    if [ ! -f "$build/build.ninja" ]; then
        echo "Configuring" >&2
        log=$(mktemp)
        if ! (cd "$root" && cmake --preset release) >"$log" 2>&1; then
            cat "$log" >&2
            rm -f "$log"
            fail "cannot configure"
        fi
        rm -f "$log"
    fi
    # The look at the revision runs every time, and is not worth a line.
    ninja -C "$build" "${targets[@]}" |
        { grep --line-buffered -vE '^ninja: (Entering|no work)|revision\.cmake' >&2 || true; }
    [ "${PIPESTATUS[0]}" -eq 0 ] || fail "cannot build"
}

setup() {
    install_packages
    configure_and_build "$@"
}
