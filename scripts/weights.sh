#!/usr/bin/env bash
# Makes the weights of the program from data: docs/weights.md, "From data to the files". If run again, it continues where
# it stopped: finished files are kept, and interrupted training is resumed.
set -euo pipefail

usage() {
  cat <<'TEXT'
scripts/weights.sh --nyu DIR -o DIR [OPTIONS] small|default|anything ...

Makes the named weights, NAME.safetensors in the output folder, and what they are built from: `default` is first taught by
`anything`, which starts from a first default; a pretrained network becomes part of `small` and `default`, and `anything` tells it
the depths of photographs.

  --nyu DIR           frames of NYU Depth v2, labelled: DIR/train/SCENE/FRAME.jpg and FRAME_depth.png
  --more DIR          further frames, DIR/SET/FRAME.jpg and FRAME_depth.png, for everything after a first default and a first small
  --photos DIR        photographs without depths, DIR/SET/FRAME.jpg, for the map of depth of `small` and `default`
  --backbone FILE     EfficientNet-Lite0, saved as docs/training.md tells, for `small` and `default`
  -o, --output DIR    where everything is made; the same command with the same folder goes on
  --steps-scale X     that part of the steps of every training, 0.001 for a trial [default: 1]
  --lsdc PROGRAM      the program [default: lsdc]

For `default` and `anything`, and for `small` with photographs, the encoder of `anything` must be installed (`lsdc weights get
anything`). Needs Python with numpy.
TEXT
}

fail() {
  echo "weights.sh: $1" >&2
  exit 2
}

here=$(cd "$(dirname "$0")" && pwd)
nyu='' more='' photos='' backbone='' out='' scale=1 lsdc=lsdc names=()
while [ $# -gt 0 ]; do
  case $1 in
  -h | --help) usage && exit ;;
  --nyu | --more | --photos | --backbone | -o | --output | --steps-scale | --lsdc)
    [ $# -ge 2 ] || fail "$1 needs a value"
    case $1 in
    --nyu) nyu=$2 ;;
    --more) more=$2 ;;
    --photos) photos=$2 ;;
    --backbone) backbone=$2 ;;
    -o | --output) out=$2 ;;
    --steps-scale) scale=$2 ;;
    --lsdc) lsdc=$2 ;;
    esac
    shift ;;
  small | default | anything) names+=("$1") ;;
  *) fail "\`$1\` is not known: see --help" ;;
  esac
  shift
done
[ -n "$out" ] && [ ${#names[@]} -gt 0 ] || { usage >&2 && exit 2; }
[ -d "$nyu/train" ] || fail "\`$nyu\` has no folder \`train\`: give --nyu DIR"
for folder in "$more" "$photos"; do
  [ -z "$folder" ] || [ -d "$folder" ] || fail "\`$folder\` is no folder"
done
command -v "$lsdc" >/dev/null || fail "\`$lsdc\` is not there: give --lsdc PROGRAM"
asked_for() { [[ " ${names[*]} " == *" $1 "* ]]; }
if asked_for default || asked_for anything || [ -n "$photos" ]; then
  installed=$("$lsdc" weights list 2>/dev/null | grep '^anything ' || true)
  [[ $installed != *"not installed"* && $installed == *installed* ]] ||
    fail "the encoder of \`anything\` is not installed: lsdc weights get anything"
fi
if asked_for default || asked_for small || [ -n "$backbone" ]; then
  [ -n "$backbone" ] || fail "small and default contain EfficientNet-Lite0: give --backbone FILE"
  [ -f "$backbone" ] || fail "\`$backbone\` is no file: give --backbone FILE"
  backbone=$(realpath "$backbone")
fi
python3 -c 'import numpy' 2>/dev/null || fail "python3 has no numpy"

nyu=$(realpath "$nyu")
[ -z "$more" ] || more=$(realpath "$more")
[ -z "$photos" ] || photos=$(realpath "$photos")
lsdc=$(realpath "$(command -v "$lsdc")")
mkdir -p "$out"
# The history in weights has paths relative to this folder, not those of this machine.
cd "$out"

# Do not continue with other data.
asked="nyu $nyu
more $more
photos $photos
steps-scale $scale"
[ -e asked ] || echo "$asked" >asked
[ "$(<asked)" = "$asked" ] || fail "\`$out\` was begun with other options: $(tr '\n' ' ' <asked)"

# A calibration is not interrupted, but nothing starts after it.
trap 'exit 130' INT TERM

say() { echo "weights.sh: $*" >&2; }

# Copied, so that the history has a relative path.
if [ -n "$backbone" ]; then
  if [ ! -e efficientnet-lite0.pth ]; then
    cp "$backbone" efficientnet-lite0.part
    mv efficientnet-lite0.part efficientnet-lite0.pth
  fi
  cmp -s "$backbone" efficientnet-lite0.pth || fail "\`$out\` was begun with another --backbone"
fi

run_of() { echo "runs/$1/weights.safetensors"; }

# all_frames: includes the further frames; fewer_others, few_others: these only as 40 and 15 % of the samples. for_map: the data
# for the depth map, with photographs as 35 % and fewer other frames.
all_frames=() fewer_others=() few_others=()
further="dataset = 'folder', root = '$more', folder = { rgb = '{set}/{frame}.jpg', depth = '{set}/{frame}_depth.png' }"
images="dataset = 'folder', root = '$photos', folder = { rgb = '{set}/{frame}.jpg', depth = '' }"
[ -z "$more" ] || all_frames=(--set "data.more=[{ $further }]")
[ -z "$more" ] || fewer_others=(--set "data.more=[{ share = 0.4, $further }]")
[ -z "$more" ] || few_others=(--set "data.more=[{ share = 0.15, $further }]")
all_frames+=(--set "train.features=features")
for_map=("${fewer_others[@]}")
if [ -n "$photos" ]; then
  beside="{ share = 0.35, $images }"
  [ -z "$more" ] || beside="{ share = 0.2, $further }, $beside"
  for_map=(--set "data.more=[$beside]" --set train.teacher.weights=anything.safetensors --set train.teacher.folder=answers
    --set train.teacher.target=images)
fi

# train NAME CONFIG OPTION...: a run of the recipe, with weights at `run_of NAME`. They are complete when the command has ended,
# because it calibrates them after writing them.
train() {
  local name=$1 config=$2 folder=runs/$1 steps
  shift 2
  if [ -e "$folder/complete" ]; then
    say "$name is there"
    return
  fi
  if [ -e "$folder/config.toml" ]; then
    say "$name goes on"
    "$lsdc" train --resume "$folder"
  else
    say "$name begins"
    steps=$("$lsdc" config --config "$config" "$@" | awk -v scale="$scale" '
      /^\[/ { train = $0 == "[train]" }
      train && $1 == "steps" { steps = int($3 * scale + 0.5) }
      END { print (steps > 0 ? steps : 1) }')
    "$lsdc" train --config "$config" --root "$nyu" -o "$folder" "$@" --set "train.steps=$steps"
  fi
  touch "$folder/complete"
}

# links: links every third training frame of NYU.
links() {
  local image depth target
  [ ! -e third/complete ] || return 0
  (cd "$nyu/train" && find -L . -name '*.jpg') | LC_ALL=C sort | awk 'NR % 3 == 1' | while read -r image; do
    depth=${image%.jpg}_depth.png
    target=third/train/$(dirname "$image")
    mkdir -p "$target"
    ln -sf "$nyu/train/$image" "$nyu/train/$depth" "$target"
  done
  touch third/complete
}

# finish NAME WEIGHTS: learns the prior from all frames, then the distribution of errors from a third, and writes
# NAME.safetensors in f16, as `lsdc calibrate` always does.
finish() {
  local name=$1 weights=$2 prior=calibrated/$1.safetensors
  if [ -e "$name.safetensors" ]; then
    say "$name.safetensors is there"
    return
  fi
  links
  mkdir -p calibrated
  say "$name is calibrated"
  [ -e "$prior" ] || "$lsdc" calibrate --dataset nyu --root "$nyu" --weights "$weights" -o "$prior"
  "$lsdc" calibrate --only-errors --dataset nyu --root third --weights "$prior" -o "$name.safetensors"
}

# Basis functions at half and full size, then affinities, then both.
first_default() {
  train half nyu-half.toml
  train bases nyu-bases.toml --set "train.start=$(run_of half)"
  train affinities nyu-affinities.toml --set "train.start=$(run_of bases)"
  train joint nyu-joint.toml --set "train.start=$(run_of affinities)"
}

first_small() {
  train small-half nyu-half.toml --set preset=small --set train.steps=6000
  train small-affinities nyu-affinities.toml --set preset=small --set train.steps=1200 --set "train.start=$(run_of small-half)"
  train small-joint nyu-joint.toml --set preset=small --set train.steps=1200 --set "train.start=$(run_of small-affinities)"
}

# beside_backbone NAME START PRESET: trains the depth map predicted by a pretrained network, longer with photographs, of which
# there are many; then basis functions together with it.
beside_backbone() {
  local name=$1 start=$2 preset=$3 map=$1-map
  train "$map" nyu-map.toml "${for_map[@]}" --set "preset=$preset" --set "train.start=$start" --set train.seed=8
  if [ -n "$photos" ]; then
    train "$map-again" nyu-map.toml "${for_map[@]}" --set "preset=$preset" --set "train.start=$(run_of "$map")" \
      --set train.steps=2400 --set train.seed=10
    map+=-again
  fi
  train "$name-lite" nyu-lite.toml "${few_others[@]}" --set "preset=$preset" --set "train.start=$(run_of "$map")" \
    --set train.seed=9
  finish "$name" "$(run_of "$name-lite")"
}

# Distils all of `anything`; then trains only the basis functions, with the affinities of the start, which other frames do not
# improve, first with some other frames, then with those of NYU.
taught() {
  local start own=runs/taught-own-affinities.safetensors
  start=$(run_of joint)
  local alone=(nyu-anything.toml --set preset=taught --set train.part=bases --set train.average=0.995
    --set train.freeze_statistics=0.0 --set train.views=0 --set train.loss.balance=0.4)
  train taught nyu-distill.toml "${all_frames[@]}" --set "train.start=$start" \
    --set train.teacher.weights=anything.safetensors --set train.teacher.folder=answers
  [ -e "$own" ] || python3 "$here/average.py" "$(run_of taught)" "$start" --only edges --share 1 -o "$own"
  train taught-bases "${alone[@]}" "${few_others[@]}" --set "train.start=$own" --set train.steps=2000 \
    --set train.learning_rate=1.5e-3 --set train.supervision.fewest=20 --set train.seed=6
  train taught-last "${alone[@]}" --set "train.start=$(run_of taught-bases)" --set train.steps=1300 \
    --set train.learning_rate=1e-3 --set train.supervision.fewest=60 --set train.seed=7
}

# anything: on top of the encoder; first the basis functions, then everything, then with more points, then with all numbers of
# points again. The mean of the last two is better than each, and so is its mean with a last run with many points.
make_anything() {
  [ ! -e anything.safetensors ] || { say "anything.safetensors is there"; return 0; }
  first_default
  local recipe=(nyu-anything.toml "${all_frames[@]}") on=(--set train.part=all)
  local mean=runs/anything-mean.safetensors last=runs/anything-last-mean.safetensors
  train anything-bases "${recipe[@]}" --set "train.start=$(run_of joint)"
  train anything-all "${recipe[@]}" "${on[@]}" --set train.steps=2600 --set train.learning_rate=3e-3 \
    --set train.average=0.995 --set "train.start=$(run_of anything-bases)"
  on+=(--set train.average=0.998 --set train.freeze_statistics=0.0)
  train anything-many "${recipe[@]}" "${on[@]}" --set train.steps=3000 --set train.supervision.fewest=20 \
    --set "train.start=$(run_of anything-all)"
  train anything-few "${recipe[@]}" "${on[@]}" --set train.steps=1800 --set train.seed=1 \
    --set "train.start=$(run_of anything-many)"
  [ -e "$mean" ] || python3 "$here/average.py" "$(run_of anything-many)" "$(run_of anything-few)" -o "$mean"
  train anything-last "${recipe[@]}" "${on[@]}" "${fewer_others[@]}" --set train.steps=2600 --set train.seed=5 \
    --set train.supervision.fewest=40 --set train.views=4 --set "train.start=$mean"
  [ -e "$last" ] || python3 "$here/average.py" "$mean" "$(run_of anything-last)" -o "$last"
  finish anything "$last"
}

make_default() {
  make_anything
  first_default
  taught
  beside_backbone default "$(run_of taught-last)" lite
}

make_small() {
  [ -z "$photos" ] || make_anything
  first_small
  beside_backbone small "$(run_of small-joint)" lite-small
}

for name in "${names[@]}"; do "make_$name"; done
for name in "${names[@]}"; do echo "$out/$name.safetensors"; done
