#pragma once

#include <functional>
#include <string>

#include "experiments/verify.h"
#include "scenegraph/scene.h"

namespace crofton {

/// A ray that fails, and the triangles that it takes.
struct FailingCase {
    TriangleMesh mesh;
    Ray ray;
};

/// Shrinks a case as long as it fails: leaves out triangles (Zeller, Hildebrandt 2002, Simplifying
/// and Isolating Failure-Inducing Input), then unused corners, then digits of the ray and of the
/// corners, and the ends of the ray's interval.
/// @param fails  true for `start`
FailingCase minimise(FailingCase start, const std::function<bool(const FailingCase&)>& fails);

/// Whether an accelerator has a fault in this case: its answer is no right one and not inside the
/// margin, or it is not brute_force's.
bool has_fault(const FailingCase& c, const std::string& accelerator);

/// All triangles of a scene as they are placed.
TriangleMesh placed_triangles(const Scene& scene);

/// Minimises the first ray of the list that fails over the placed triangles of its scene; writes
/// them to `obj_file`, and the ray beside it, to be replayed, as `obj_file`.jsonl.
/// @return  what was written, or why nothing was
/// @throws InputError  a file cannot be written
std::string minimise_to_files(const std::vector<FailingRay>& rays, const std::string& obj_file);

}  // namespace crofton
