#!/usr/bin/env bash
# Package: carbs 1.0.4 with gncpy 2.0.3 and serums 1.0.6. Needs Python 3.9: carbs asks for less than 3.10.
# Expected: the first detection of an object gives a Bernoulli of existence P_d q / (clutter + P_d q), where q is the
#   birth intensity at the detection (Williams, IEEE TAES 51, 2015; Garcia-Fernandez et al., IEEE TAES 54, 2018):
#   far from every birth component q is 0, the detection is clutter and existence 0.
# Seen: PoissonMultiBernoulliMixture puts the clutter into the numerator as well. 100 m from a birth component of
#   standard deviation 2 m a detection makes an object of existence P_d / (1 + P_d) = .474, whatever the clutter
#   density, at 5 m it is .751 for .702, and on the component .964 for .966.
# Why it matters: no detection is ever believed to be clutter, so every false alarm starts a track that needs several
#   misses to die; as a reference PMBM its false tracks and GOSPA in clutter are not the filter's.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3.9}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps carbs==1.0.4 gncpy==2.0.3 serums==1.0.6 numpy==2.0.2 scipy==1.13.1 \
  matplotlib==3.9.4 pandas==2.3.3 pytz==2026.6 tzdata==2026.6 python-dateutil==3.0.0 six==1.17.0 pillow==11.3.0 \
  cycler==0.12.1 kiwisolver==1.4.7 contourpy==1.3.0 pyparsing==3.3.3 packaging==26.3 fonttools==4.60.2 \
  importlib_resources==6.5.2 zipp==3.23.1 probscale==0.2.5 ruamel.yaml==0.19.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from carbs.swarm_estimator.tracker import PoissonMultiBernoulliMixture
from gncpy.filters import KalmanFilter
from serums.models import GaussianMixture

detection, weight = 0.9, 0.1


def existence(distance, clutter):
    """Existence after one detection at ``distance`` of a birth component."""
    kf = KalmanFilter()
    kf.set_state_model(state_mat=np.eye(2))
    kf.set_measurement_model(meas_mat=np.eye(2))
    kf.proc_noise, kf.meas_noise, kf.cov = 0.01 * np.eye(2), np.eye(2), 4 * np.eye(2)
    birth = GaussianMixture(
        means=[np.zeros((2, 1))], covariances=[4 * np.eye(2)], weights=np.array([weight])
    )
    tracker = PoissonMultiBernoulliMixture(
        req_upd=10,
        in_filter=kf,
        birth_terms=[birth],
        prob_survive=0.99,
        prob_detection=detection,
        clutter_rate=1.0,
        clutter_den=clutter,
    )
    tracker.predict(0)
    tracker.correct(0, [np.array([[distance], [0.0]])])
    (track,) = tracker._track_tab  # no public name for it
    return track.exist_prob


for distance in (0.0, 5.0, 100.0):
    q = weight * np.exp(-0.5 * distance**2 / 5) / (2 * np.pi * 5)  # innovation variance 4 + 1
    right = detection * q / (1e-4 + detection * q)
    seen = existence(distance, 1e-4)
    print(f"detection {distance:.0f} m from the birth component: existence {seen:.3f}, right {right:.3f}")
for clutter in (1e-6, 1e-4, 1e-2):
    assert np.isclose(existence(100.0, clutter), detection / (1 + detection))
EOF
