// Suppresses overlapping reports.  The plain version is _suppress_overlaps() of estimation.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gate.hpp"

namespace pmbm {

// Whether the point lies in a box: position, and z, length, width, height, yaw.
inline bool inside(const double* point, const double* position, const double* box) {
    const double dx = point[0] - position[0], dy = point[1] - position[1];
    const double c = std::cos(box[4]), s = std::sin(box[4]);
    return std::abs(c * dx + s * dy) < box[1] / 2 && std::abs(c * dy - s * dx) < box[2] / 2;
}

// Boxes (N,5) at positions (N,2), in the order in which they are to be asked; the first `sure` of
// these may hold others back.
inline std::vector<std::int64_t> suppress_overlaps(const double* position, const double* box,
                                          const std::int64_t* order, std::size_t count,
                                          std::size_t sure, double larger) {
    std::vector<char> stands(count, 0), holds(count, 0);
    const Grid grid(position, count);
    double reach = 0;
    for (std::size_t i = 0; i < count; ++i) {
        reach = std::max(reach, std::hypot(box[5 * i + 1], box[5 * i + 2]) / 2);
    }
    std::vector<std::size_t> rivals;
    for (std::size_t n = 0; n < count; ++n) {
        const auto b = static_cast<std::size_t>(order[n]);
        const double *at = position + 2 * b, *own = box + 5 * b;
        rivals.clear();
        grid.in_box(at[0], at[1], reach, reach, [&](std::int64_t other) {
            const auto a = static_cast<std::size_t>(other);
            if (!holds[a]) return;
            const double *there = position + 2 * a, *its = box + 5 * a;
            if (std::abs(there[0] - at[0]) > reach || std::abs(there[1] - at[1]) > reach) return;
            if (inside(at, there, its) || inside(there, at, own)) rivals.push_back(a);
        });
        const double area = own[1] * own[2];
        const bool whole = std::all_of(rivals.begin(), rivals.end(), [&](std::size_t a) {
            return area > larger * box[5 * a + 1] * box[5 * a + 2];
        });
        if (!whole) continue;
        stands[b] = 1;
        holds[b] = n < sure;
        for (const auto a : rivals) stands[a] = holds[a] = 0;
    }
    std::vector<std::int64_t> rows;
    for (std::size_t i = 0; i < count; ++i) {
        if (stands[i]) rows.push_back(static_cast<std::int64_t>(i));
    }
    return rows;
}

}  // namespace pmbm
