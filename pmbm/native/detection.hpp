// P_D of tracks, and what a track remembers of its detections.  The plain versions are the models of
// detection.py.
#pragma once

#include <algorithm>
#include <limits>

namespace pmbm {

// P_D = clip(low + (high - low) c) (d + (1 - d) undetectable), where c is the running mean of past
// scores, or 1 less that, and d = P(detectable).  One P_D for all has low = high; without a chain,
// d is 1 for ever.
struct DetectionLaw {
    double low, high;
    bool rising;
    // Weight of the newest score; d in the long run, and what is left of d's distance from it.
    double newest, undetectable, usual, memory;

    double predicted(double detectable) const { return usual + (detectable - usual) * memory; }

    double share(double detectable) const { return detectable + (1 - detectable) * undetectable; }

    double probability(double confidence, double detectable) const {
        const double told = rising ? confidence : 1 - confidence;
        return std::clamp(low + (high - low) * told, low, high) * share(detectable);
    }

    double mean_score(double before, double newly) const {
        return (1 - newest) * before + newest * newly;
    }

    double if_missed(double detectable, double P_D) const {
        const double missed_if_detectable =
            1 - P_D / std::max(share(detectable), std::numeric_limits<double>::min());
        const double chance = 1 - P_D;
        return chance > 0 ? detectable * missed_if_detectable / chance : detectable;
    }

    double if_detected(double detectable) const {
        return detectable / std::max(share(detectable), std::numeric_limits<double>::min());
    }
};

}  // namespace pmbm
