#!/usr/bin/env bash
# The baselines' KITTI presets: each class by the same budget, on the sequences for tuning.
#   studies/tune_kitti.sh        in a folder where `kitti` is the dataset; writes tuned/ and presets/
set -euo pipefail
trials=${TRIALS:-20}
mkdir -p tuned presets
for tracker in argoverse waymo probabilistic_kf; do
  for class in Car Pedestrian Cyclist; do
    file=tuned/${tracker}_$class.toml
    fit=()
    if [ "$tracker" = probabilistic_kf ]; then fit=(--fit); fi
    [ -s "$file" ] || pmbm tune --dataset kitti --root kitti --poses kitti/pose \
      --detections 'kitti/detections/pointrcnn_{class}' --class "$class" --metric MOTA \
      --sequences 0000 0002 0003 0004 0005 0007 0009 0011 0017 \
      --tracker "$tracker" --config /dev/null "${fit[@]}" --trials "$trials" --seed 1 \
      --jobs "${JOBS:-2}" --out "$file"
  done
  cat tuned/"${tracker}"_{Car,Pedestrian,Cyclist}.toml > "presets/kitti_$tracker.toml"
done
