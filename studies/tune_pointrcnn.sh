#!/usr/bin/env bash
# The trackers of studies/pointrcnn.toml: each by the same budget, on seeds for tuning.
#   studies/tune_pointrcnn.sh    in the project's folder; writes studies/pointrcnn/tuned_TRACKER.toml
set -euo pipefail
folder=studies/pointrcnn
for tracker in pmbm argoverse waymo probabilistic_kf; do
  file=$folder/tuned_$tracker.toml
  fit=()
  case $tracker in pmbm | probabilistic_kf) fit=(--fit) ;; esac
  [ -s "$file" ] || pmbm tune studies/pointrcnn/{street,agents,two_way}.toml --metric mota \
    --tracker "$tracker" "${fit[@]}" --recordings 2 --held-back 5 --trials "${TRIALS:-20}" \
    --seed 1 --jobs "${JOBS:-2}" --out "$file"
done
