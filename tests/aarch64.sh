#!/bin/sh
# Makes FOLDER/python, a Python for aarch64 with JAX and pytest, which qemu-user runs on x86-64.
#
#   sudo apt-get install g++-aarch64-linux-gnu qemu-user
#   tests/aarch64.sh FOLDER .venv/bin/python
#
# It takes Debian's packages (about 15 MB) and the wheels of constraints.txt (about 200 MB).
# Nothing is installed outside FOLDER, so that it needs no root.
set -eu
tests=$(cd "$(dirname "$0")" && pwd)
pip_python=$2
mkdir -p "$1/apt/state/lists/partial" "$1/apt/cache/archives/partial" "$1/debs" "$1/root"
cd "$1"
folder=$(pwd)

# apt-get as on a machine of that kind, with its lists here.
cat > apt/conf <<END
APT::Architecture "arm64";
APT::Architectures { "arm64"; };
Dir::State "$folder/apt/state";
Dir::State::status "/dev/null";
Dir::Cache "$folder/apt/cache";
END
export APT_CONFIG="$folder/apt/conf"
apt-get update --quiet
packages=$(apt-cache depends --recurse --no-recommends --no-suggests --no-conflicts --no-breaks \
  --no-replaces --no-enhances python3 libstdc++6 | grep '^[a-z]' | sort -u |
  grep -Ev '^(lib)?perl|^(dpkg|install-info|mailcap|mime-support|tar)$')
(cd debs && apt-get download --quiet $packages)
for deb in debs/*.deb; do dpkg -x "$deb" root; done
unset APT_CONFIG

version=$(basename "$(readlink root/usr/bin/python3)")
set -- jax flax absl-py pytest
for minor in 17 24 26 27 28 34; do set -- "$@" --platform="manylinux_2_${minor}_aarch64"; done
"$pip_python" -m pip install --quiet --target=packages --platform=manylinux2014_aarch64 \
  --python-version="${version#python}" --only-binary=:all: --constraint="$tests/../constraints.txt" "$@"

# The wrapper is its own sys.executable, so that processes that Python starts run under qemu too.
cat > python.new <<END
#!/bin/sh
export PYTHONHOME="$folder/root/usr" PYTHONPATH="\$PYTHONPATH:$folder/packages"
exec qemu-aarch64 -L "$folder/root" -0 "\$0" "$folder/root/usr/bin/$version" "\$@"
END
chmod +x python.new
mv python.new python # the last step: who finds it finds all
