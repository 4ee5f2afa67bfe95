// Neighbours and possible collisions on a road.  The plain versions, of the same names, are in
// lines.py and collisions.py and say what is meant.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

namespace pmbm {

// along, aside (N,M) : of N things on M lanes.  seen (N,) : by a search.
// first (M+1,), searched, offset : of each lane, those that a search from it looks at in turn.
struct Lanes {
    const double *along, *aside;
    const bool* seen;
    std::size_t things;
    const double *half_width, *length;
    std::size_t lanes;
    const std::int64_t *first, *searched;
    const double* offset;
};

constexpr double kBesideLane = 1.0;

// Who is found on a lane: (place, row), in order of place and, among equals, of rows.
inline std::vector<std::pair<double, std::int64_t>> on_lane(const Lanes& at, std::int64_t column,
                                                           double reach) {
    std::vector<std::pair<double, std::int64_t>> found;
    for (std::size_t n = 0; n < at.things; ++n) {
        if (!at.seen[n]) continue;
        for (auto k = at.first[column]; k < at.first[column + 1]; ++k) {
            const auto lane = static_cast<std::size_t>(at.searched[k]);
            const double along = at.along[n * at.lanes + lane];
            if (std::abs(at.aside[n * at.lanes + lane]) <= at.half_width[lane] + kBesideLane &&
                along >= -reach && along < at.length[lane] + reach) {
                found.emplace_back(along + at.offset[k], static_cast<std::int64_t>(n));
                break;
            }
        }
    }
    std::sort(found.begin(), found.end());
    return found;
}

// Rows of the front and of the rear neighbour of things `row` (Q,) on lanes `column` (Q,).
inline void neighbours(const Lanes& at, const std::int64_t* row, const std::int64_t* column,
                       std::size_t queries, double reach, std::vector<std::int64_t>& front,
                       std::vector<std::int64_t>& rear) {
    front.assign(queries, -1);
    rear.assign(queries, -1);
    std::vector<std::size_t> order(queries);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](auto a, auto b) { return column[a] < column[b]; });
    std::vector<std::pair<double, std::int64_t>> line;
    for (std::size_t q = 0; q < queries; ++q) {
        const auto own = row[order[q]], lane = column[order[q]];
        if (q == 0 || lane != column[order[q - 1]]) line = on_lane(at, lane, reach);
        const double place = at.along[static_cast<std::size_t>(own) * at.lanes +
                                      static_cast<std::size_t>(lane)];
        const auto here = std::lower_bound(
            line.begin(), line.end(), place,
            [](const auto& thing, double value) { return thing.first < value; });
        // Of equals the front one is the last in the road's list, and the rear one the first.
        double best = 0;
        for (auto thing = here; thing != line.end(); ++thing) {
            if (thing->second == own) continue;
            if (front[order[q]] >= 0 && thing->first > best) break;
            front[order[q]] = thing->second;
            best = thing->first;
        }
        for (auto thing = here; thing != line.begin();) {
            --thing;
            if (thing->second == own) continue;
            if (rear[order[q]] >= 0 && thing->first < best) break;
            rear[order[q]] = thing->second;
            best = thing->first;
        }
    }
}

// N boxes, the first `vehicles` of them vehicles.
struct Movers {
    const double *position, *heading, *speed, *half_length, *half_width;
    std::size_t things, vehicles;
};

inline void near_pairs(const Movers& at, double dt, double margin,
                       std::vector<std::int64_t>& first, std::vector<std::int64_t>& second) {
    struct Box {
        double x, y, radius, ahead[2], moved[2];
        std::size_t row;
    };
    std::vector<Box> box(at.things);
    double widest = 0, farthest = 0;
    for (std::size_t n = 0; n < at.things; ++n) {
        const double cos = std::cos(at.heading[n]), sin = std::sin(at.heading[n]);
        const double way = at.speed[n] * dt;
        box[n] = {at.position[2 * n], at.position[2 * n + 1],
                  std::hypot(at.half_length[n], at.half_width[n]),
                  {cos, sin}, {way * cos, way * sin}, n};
        widest = std::max(widest, box[n].radius);
        farthest = std::max(farthest, way);
    }
    std::sort(box.begin(), box.end(), [](const Box& a, const Box& b) { return a.x < b.x; });
    const double reach = 2 * widest + farthest + margin;
    std::vector<std::pair<std::int64_t, std::int64_t>> found;
    for (std::size_t i = 0; i < at.things; ++i) {
        for (std::size_t j = i + 1; j < at.things && box[j].x - box[i].x <= reach; ++j) {
            const bool ordered = box[i].row < box[j].row;
            const Box &a = box[ordered ? i : j], &b = box[ordered ? j : i];
            if (a.row >= at.vehicles) continue;
            const double dx = b.x - a.x, dy = b.y - a.y;
            const double limit =
                std::max(a.radius + b.radius + at.speed[a.row] * dt + margin, 0.0);
            if (dx * dx + dy * dy > limit * limit) continue;
            const double drift[2] = {a.moved[0] - b.moved[0], a.moved[1] - b.moved[1]};
            bool apart = false;
            for (int k = 0; k < 4 && !apart; ++k) {
                const auto& ahead = k < 2 ? a.ahead : b.ahead;
                const double x = k % 2 ? -ahead[1] : ahead[0], y = k % 2 ? ahead[0] : ahead[1];
                const double between = dx * x + dy * y;
                double extent = 0;
                for (const Box* one : {&a, &b}) {
                    extent += at.half_length[one->row] *
                              std::abs(one->ahead[0] * x + one->ahead[1] * y);
                    extent += at.half_width[one->row] *
                              std::abs(one->ahead[0] * y - one->ahead[1] * x);
                }
                const double toward = (drift[0] * x + drift[1] * y) * (between >= 0 ? 1.0 : -1.0);
                apart = std::abs(between) - extent - std::max(toward, 0.0) > margin;
            }
            if (!apart) {
                found.emplace_back(static_cast<std::int64_t>(a.row),
                                   static_cast<std::int64_t>(b.row));
            }
        }
    }
    std::sort(found.begin(), found.end());
    for (const auto& [a, b] : found) {
        first.push_back(a);
        second.push_back(b);
    }
}

}  // namespace pmbm
