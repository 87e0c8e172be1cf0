// The iterative Hough transform (Dalitz et al., IPOL 2017), written straight from its
// algorithms 1 and 2: one dense accumulator over all cells and directions, every point
// voting in every direction, the whole accumulator scanned for each line.
//
// It is what the search of this project is measured against, in the same run and on the
// same points, and what its lines are compared with. Doubles throughout.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <map>
#include <tuple>
#include <vector>

namespace {

struct Vec {
  double x = 0, y = 0, z = 0;
};

Vec operator+(const Vec& p, const Vec& q) { return {p.x + q.x, p.y + q.y, p.z + q.z}; }
Vec operator-(const Vec& p, const Vec& q) { return {p.x - q.x, p.y - q.y, p.z - q.z}; }
Vec operator*(double s, const Vec& p) { return {s * p.x, s * p.y, s * p.z}; }
double dot(const Vec& p, const Vec& q) { return p.x * q.x + p.y * q.y + p.z * q.z; }
double norm(const Vec& p) { return std::sqrt(p.x * p.x + p.y * p.y + p.z * p.z); }

struct Line {
  Vec anchor, direction, cell_anchor, cell_direction;
  std::int64_t votes = 0;
  std::vector<std::int64_t> members;
};

// Half a sphere of directions: an icosahedron in single precision, each face cut into
// four as often as the granularity says, one of each pair of opposite vertices kept.
std::vector<Vec> make_directions(int granularity) {
  const float ratio = 1.61803399f;
  const float length = std::sqrt(1 + ratio * ratio);
  const double s = 1 / length, l = ratio / length;
  std::vector<Vec> vertices = {{-s, l, 0},  {s, l, 0},  {0, s, -l}, {0, s, l},
                               {-l, 0, -s}, {l, 0, -s}, {-l, 0, s}, {l, 0, s},
                               {0, -s, -l}, {0, -s, l}, {-s, -l, 0}, {s, -l, 0}};
  std::vector<std::vector<int>> faces = {
      {0, 1, 2}, {0, 1, 3}, {0, 2, 4}, {0, 4, 6},   {0, 3, 6},  {1, 2, 5},  {1, 3, 7},
      {1, 5, 7}, {2, 4, 8}, {2, 5, 8}, {3, 6, 9},   {3, 7, 9},  {4, 8, 10}, {8, 10, 11},
      {5, 8, 11}, {5, 7, 11}, {7, 9, 11}, {9, 10, 11}, {6, 9, 10}, {4, 6, 10}};
  for (int level = 0; level < granularity; ++level) {
    std::map<std::tuple<double, double, double>, int> known;
    auto middle = [&](int i, int j) {
      Vec m = vertices[i] + vertices[j];
      const double n = norm(m);
      m = {m.x / n, m.y / n, m.z / n};
      auto [entry, fresh] = known.try_emplace({m.x, m.y, m.z}, int(vertices.size()));
      if (fresh) vertices.push_back(m);
      return entry->second;
    };
    std::vector<std::vector<int>> smaller;
    for (const auto& f : faces) {
      const int d = middle(f[0], f[1]), e = middle(f[1], f[2]), g = middle(f[2], f[0]);
      smaller.push_back({f[0], d, g});
      smaller.push_back({d, f[1], e});
      smaller.push_back({g, e, f[2]});
      smaller.push_back({g, d, e});
    }
    faces = smaller;
  }
  std::vector<Vec> kept;
  for (const Vec& v : vertices)
    if (v.z > 0 || (v.z == 0 && (v.x > 0 || (v.x == 0 && v.y != -1)))) kept.push_back(v);
  return kept;
}

double nearest_integer(double v) { return v > 0 ? std::floor(v + 0.5) : std::ceil(v - 0.5); }

class Accumulator {
 public:
  Accumulator(const std::vector<Vec>& directions, double reach, double dx)
      : directions_(directions), reach_(reach), dx_(dx) {
    side_ = std::size_t(nearest_integer(2 * reach / dx));
    votes_.assign(side_ * side_ * directions.size(), 0);
  }

  void vote(const Vec& p, int weight) {
    for (std::size_t j = 0; j < directions_.size(); ++j) {
      const Vec& b = directions_[j];
      const double beta = 1 / (1 + b.z);
      const double x = ((1 - (beta * (b.x * b.x))) * p.x) - ((beta * (b.x * b.y)) * p.y) - (b.x * p.z);
      const double y = ((-beta * (b.x * b.y)) * p.x) + ((1 - (beta * (b.y * b.y))) * p.y) - (b.y * p.z);
      const auto cx = std::size_t(nearest_integer((x + reach_) / dx_));
      const auto cy = std::size_t(nearest_integer((y + reach_) / dx_));
      const std::size_t index = (cx * side_ + cy) * directions_.size() + j;
      if (index < votes_.size()) votes_[index] += weight;
    }
  }

  void best(Line& line) const {
    std::uint32_t most = 0;
    std::size_t index = 0;
    for (std::size_t i = 0; i < votes_.size(); ++i)
      if (votes_[i] > most) {
        most = votes_[i];
        index = i;
      }
    const std::size_t cell = index / directions_.size();
    const double x = double(cell / side_) * dx_ - reach_, y = double(cell % side_) * dx_ - reach_;
    const Vec b = directions_[index % directions_.size()];
    line.votes = most;
    line.cell_direction = b;
    line.cell_anchor = {x * (1 - ((b.x * b.x) / (1 + b.z))) - y * ((b.x * b.y) / (1 + b.z)),
                        x * (-((b.x * b.y) / (1 + b.z))) + y * (1 - ((b.y * b.y) / (1 + b.z))),
                        -x * b.x - y * b.y};
  }

 private:
  const std::vector<Vec>& directions_;
  double reach_, dx_;
  std::size_t side_ = 0;
  std::vector<std::uint32_t> votes_;
};

std::vector<std::size_t> close_to(const std::vector<Vec>& points, const std::vector<std::size_t>& left,
                                  const Vec& a, const Vec& b, double dx) {
  std::vector<std::size_t> close;
  for (std::size_t i : left) {
    const double t = dot(b, points[i] - a);
    if (norm(points[i] - (a + t * b)) <= dx) close.push_back(i);
  }
  return close;
}

// Orthogonal least squares; the largest eigenvalue of the scatter, 0 for no extent.
double fit(const std::vector<Vec>& points, const std::vector<std::size_t>& members, Vec& a, Vec& b) {
  if (members.empty()) return 0;
  a = {};
  for (std::size_t i : members) a = a + points[i];
  a = {a.x / double(members.size()), a.y / double(members.size()), a.z / double(members.size())};
  double m[3][3] = {}, v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (std::size_t i : members) {
    const Vec p = points[i] - a;
    const double d[3] = {p.x, p.y, p.z};
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) m[r][c] += d[r] * d[c];
  }
  for (int sweep = 0; sweep < 12; ++sweep) {  // cyclic Jacobi rotations
    for (auto [p, q] : {std::pair{0, 1}, {0, 2}, {1, 2}}) {
      if (m[p][q] == 0) continue;
      const double theta = (m[q][q] - m[p][p]) / (2 * m[p][q]);
      const double t = std::copysign(1 / (std::abs(theta) + std::sqrt(theta * theta + 1)), theta);
      const double c = 1 / std::sqrt(t * t + 1), s = t * c;
      for (int k = 0; k < 3; ++k) {
        const double kp = m[k][p], kq = m[k][q];
        m[k][p] = c * kp - s * kq;
        m[k][q] = s * kp + c * kq;
      }
      for (int k = 0; k < 3; ++k) {
        const double pk = m[p][k], qk = m[q][k], vp = v[k][p], vq = v[k][q];
        m[p][k] = c * pk - s * qk;
        m[q][k] = s * pk + c * qk;
        v[k][p] = c * vp - s * vq;
        v[k][q] = s * vp + c * vq;
      }
    }
  }
  int most = 0;
  for (int k = 1; k < 3; ++k)
    if (m[k][k] > m[most][most]) most = k;
  const double n = std::sqrt(v[0][most] * v[0][most] + v[1][most] * v[1][most] + v[2][most] * v[2][most]);
  b = {v[0][most] / n, v[1][most] / n, v[2][most] / n};
  return m[most][most];
}

std::vector<Line> search(std::vector<Vec> points, double dx, const std::vector<Vec>& directions,
                         std::size_t minvotes, std::size_t nlines) {
  std::vector<Line> lines;
  if (points.size() < 2) return lines;
  auto bounds = [&] {
    Vec low = points[0], high = points[0];
    for (const Vec& p : points) {
      low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
      high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    }
    return std::pair{low, high};
  };
  auto [low, high] = bounds();
  const double diagonal = norm(high - low);
  if (dx == 0) dx = diagonal / 64;
  if (diagonal == 0 || dx >= diagonal) return lines;
  const Vec sum = low + high, shift = {sum.x / 2, sum.y / 2, sum.z / 2};
  for (Vec& p : points) p = p - shift;
  std::tie(low, high) = bounds();
  Accumulator accumulator(directions, std::max(norm(high), norm(low)), dx);
  std::vector<std::size_t> members;
  for (const Vec& p : points) accumulator.vote(p, 1);
  // Points nearer to one another than rounding have no extent.
  const double copies = 1e-14 * std::max(norm(high), norm(low));
  auto no_extent = [&](double eigenvalue) {
    return eigenvalue <= double(members.size()) * copies * copies;
  };
  std::vector<std::size_t> left(points.size());
  for (std::size_t i = 0; i < left.size(); ++i) left[i] = i;
  while (left.size() > 1 && (nlines == 0 || lines.size() < nlines)) {
    for (std::size_t i : members) accumulator.vote(points[i], -1);
    Line line;
    accumulator.best(line);
    members = close_to(points, left, line.cell_anchor, line.cell_direction, dx);
    if (no_extent(fit(points, members, line.anchor, line.direction))) break;
    members = close_to(points, left, line.anchor, line.direction, dx);
    if (members.size() < minvotes) break;
    if (no_extent(fit(points, members, line.anchor, line.direction))) break;
    line.anchor = line.anchor + shift;
    line.cell_anchor = line.cell_anchor + shift;
    line.members.assign(members.begin(), members.end());
    lines.push_back(line);
    std::vector<std::size_t> rest;
    std::set_difference(left.begin(), left.end(), members.begin(), members.end(),
                        std::back_inserter(rest));
    left = rest;
  }
  return lines;
}

}  // namespace

extern "C" {

// Directions are made once and shared, as the original node does; -1 on an unknown one.
int baseline_directions(int granularity, double* out) {
  const auto directions = make_directions(granularity);
  if (out)
    for (std::size_t i = 0; i < directions.size(); ++i) {
      out[3 * i] = directions[i].x;
      out[3 * i + 1] = directions[i].y;
      out[3 * i + 2] = directions[i].z;
    }
  return int(directions.size());
}

// Lines of a cloud. Per line `lines` gets 14 doubles: votes, number of points, anchor,
// direction, cell anchor, cell direction; `labels` gets each point's line number or -1.
int baseline_search(const double* xyz, int num_points, double dx, const double* directions,
                    int num_directions, int minvotes, int nlines, double* lines,
                    std::int32_t* labels) {
  std::vector<Vec> points(num_points), space(num_directions);
  for (int i = 0; i < num_points; ++i) points[i] = {xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]};
  for (int j = 0; j < num_directions; ++j)
    space[j] = {directions[3 * j], directions[3 * j + 1], directions[3 * j + 2]};
  const auto found = search(points, dx, space, std::max(minvotes, 2), nlines);
  std::fill(labels, labels + num_points, -1);
  for (std::size_t k = 0; k < found.size(); ++k) {
    const Line& l = found[k];
    const double row[14] = {double(l.votes), double(l.members.size()),
                            l.anchor.x, l.anchor.y, l.anchor.z,
                            l.direction.x, l.direction.y, l.direction.z,
                            l.cell_anchor.x, l.cell_anchor.y, l.cell_anchor.z,
                            l.cell_direction.x, l.cell_direction.y, l.cell_direction.z};
    std::copy(row, row + 14, lines + 14 * k);
    for (std::int64_t i : l.members) labels[i] = std::int32_t(k);
  }
  return int(found.size());
}
}
