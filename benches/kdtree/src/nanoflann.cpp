// nanoflann behind four C functions. Points stay where the caller has them.
#include <algorithm>
#include <cstdint>
#include <new>
#include <nanoflann.hpp>
#include <utility>
#include <vector>

namespace {

struct Cloud {
    const float* points;
    size_t count;
    size_t kdtree_get_point_count() const { return count; }
    float kdtree_get_pt(size_t i, size_t axis) const { return points[3 * i + axis]; }
    template <class Box> bool kdtree_get_bbox(Box&) const { return false; }
};

using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Cloud>, Cloud, 3, uint32_t>;

struct Index {
    Cloud cloud;
    Tree tree;
    Index(const float* points, size_t count)
        : cloud{points, count}, tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(10)) {
        tree.buildIndex();
    }
};

// The nearest k within a radius, in a heap: nanoflann's own RKNNResultSet came with version 1.5, and sorts by insertion.
struct Nearest {
    using DistanceType = float;
    size_t k;
    float radius2;
    std::vector<std::pair<float, uint32_t>>& heap;
    size_t size() const { return heap.size(); }
    bool full() const { return true; }
    float worstDist() const { return heap.size() < k ? radius2 : heap.front().first; }
    bool addPoint(float distance2, uint32_t index) {
        if (distance2 >= worstDist()) return true;
        if (heap.size() == k) {
            std::pop_heap(heap.begin(), heap.end());
            heap.back() = {distance2, index};
        } else {
            heap.emplace_back(distance2, index);
        }
        std::push_heap(heap.begin(), heap.end());
        return true;
    }
};

}  // namespace

extern "C" {

void* bench_nanoflann_build(const float* points, size_t count) {
    return new (std::nothrow) Index(points, count);
}

void bench_nanoflann_drop(void* index) { delete static_cast<Index*>(index); }

// Photons found for all queries, and the sum of the squared distances of the farthest.
size_t bench_nanoflann_ask(const void* index, const float* queries, size_t count, size_t k, float radius, double* sum) {
    std::vector<std::pair<float, uint32_t>> heap;
    heap.reserve(k + 1);
    size_t found = 0;
    for (size_t i = 0; i < count; i++) {
        heap.clear();
        Nearest nearest{k, radius * radius, heap};
        static_cast<const Index*>(index)->tree.findNeighbors(nearest, queries + 3 * i, nanoflann::SearchParams(0, 0, false));
        found += heap.size();
        if (!heap.empty()) *sum += heap.front().first;
    }
    return found;
}
}
