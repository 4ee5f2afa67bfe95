// A tracker as a program: every detection goes to the nearest track.  The standard library and
// nlohmann's json.hpp (Debian: nlohmann-json3-dev; PyPI: nlohmann-json).

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <numeric>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

using nlohmann::json;
using Column = std::vector<double>;

struct Track {
    std::int64_t id;
    double x, y, z, length, width, height, yaw;
    std::string label;
    double vx = 0.0, vy = 0.0, score = 0.5;
    int hits = 1;
    double seen;            // time of the last detection, s
    double seen_x, seen_y;  // where that was, m
};

class Nearest {
  public:
    explicit Nearest(const json& parameters)
        : gate(parameters.value("gate", 4.0)),
          patience(parameters.value("patience", 1.0)),
          hits(parameters.value("hits", 3)) {}

    void step(double now, const json& frame) {
        const double dt = started ? now - last : 0.0;
        started = true;
        last = now;
        for (Track& track : tracks) {
            track.x += dt * track.vx;
            track.y += dt * track.vy;
        }
        const auto column = [&](const char* name) { return frame.at(name).get<Column>(); };
        const Column x = column("x"), y = column("y"), z = column("z"), yaw = column("yaw"),
                     length = column("length"), width = column("width"),
                     height = column("height"), score = column("score");
        const auto label = frame.at("label").get<std::vector<std::string>>();
        std::vector<std::size_t> rows(score.size());
        std::iota(rows.begin(), rows.end(), 0);
        std::stable_sort(rows.begin(), rows.end(),
                         [&](auto a, auto b) { return score[a] > score[b]; });
        for (const std::size_t i : rows)
            take(now, {.id = 0, .x = x[i], .y = y[i], .z = z[i], .length = length[i],
                       .width = width[i], .height = height[i], .yaw = yaw[i],
                       .label = label[i], .seen = now, .seen_x = x[i], .seen_y = y[i]});
        std::erase_if(tracks, [&](const Track& t) { return now - t.seen > patience; });
    }

    json report() const {
        json told;
        for (const char* name : {"id", "x", "y", "z", "length", "width", "height", "yaw", "vx",
                                 "vy", "score", "label"})
            told[name] = json::array();
        for (const Track& t : tracks) {
            if (t.hits < hits) continue;
            told["id"].push_back(t.id);
            told["x"].push_back(t.x);
            told["y"].push_back(t.y);
            told["z"].push_back(t.z);
            told["length"].push_back(t.length);
            told["width"].push_back(t.width);
            told["height"].push_back(t.height);
            told["yaw"].push_back(t.yaw);
            told["vx"].push_back(t.vx);
            told["vy"].push_back(t.vy);
            told["score"].push_back(t.score);
            told["label"].push_back(t.label);
        }
        return told;
    }

  private:
    double gate, patience;
    int hits;
    std::vector<Track> tracks;
    bool started = false;
    double last = 0.0;
    std::int64_t ids = 0;

    void take(double now, Track box) {
        Track* nearest = nullptr;
        double shortest = gate;
        for (Track& track : tracks) {
            if (track.seen >= now || track.label != box.label) continue;
            const double distance = std::hypot(track.x - box.x, track.y - box.y);
            if (distance <= shortest) nearest = &track, shortest = distance;
        }
        if (nearest == nullptr) {
            box.id = ids++;
            tracks.push_back(box);
            return;
        }
        const double elapsed = now - nearest->seen;
        const double gain = nearest->hits == 1 ? 1.0 : 0.2;
        box.id = nearest->id;
        box.vx = nearest->vx + gain * ((box.x - nearest->seen_x) / elapsed - nearest->vx);
        box.vy = nearest->vy + gain * ((box.y - nearest->seen_y) / elapsed - nearest->vy);
        box.hits = nearest->hits + 1;
        box.score = std::min(0.5 + 0.1 * box.hits, 0.99);
        *nearest = box;
    }
};

int main() {
    using Clock = std::chrono::steady_clock;
    std::ios::sync_with_stdio(false);
    Nearest tracker{json::object()};
    for (std::string line; std::getline(std::cin, line);) {
        const json message = json::parse(line);
        json answer;
        if (message.at("type") == "start") {
            tracker = Nearest(message.at("parameters"));
            answer = {{"type", "ready"}, {"protocol", 1}};
        } else {
            const auto start = Clock::now();
            tracker.step(message.at("time"), message);
            const std::chrono::duration<double> took = Clock::now() - start;
            answer = tracker.report();
            answer["type"] = "tracks";
            answer["step"] = message.at("step");
            answer["seconds"] = took.count();
        }
        std::cout << answer.dump() << std::endl;
    }
}
