#include "scenegraph/assemble.h"

#include <atomic>
#include <map>
#include <tuple>

#include "accelerators/opening.h"
#include "framework/clock.h"
#include "framework/error.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/parallel.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/triangle_set.h"
#include "scenegraph/baking.h"
#include "scenegraph/shape_sets.h"

namespace crofton {
namespace {

/// Glob over [p, p_end) and [s, s_end): `?` one character but '/', `*` any run without '/', `**`
/// any run.
bool glob(const char* p, const char* p_end, const char* s, const char* s_end) {
    // Backtracking to the last star only would be wrong with two kinds of them: a table of what
    // prefix of the text each prefix of the pattern can match, one row at a time.
    const size_t n = size_t(s_end - s);
    std::vector<char> row(n + 1, 0), next(n + 1, 0);
    row[0] = 1;
    for (; p != p_end; ++p) {
        std::fill(next.begin(), next.end(), 0);
        const bool deep = *p == '*' && p + 1 != p_end && p[1] == '*';
        if (*p == '*') {
            for (size_t j = 0; j <= n; ++j)
                next[j] = row[j] || (j > 0 && next[j - 1] && (deep || s[j - 1] != '/'));
            if (deep) ++p;
        } else {
            for (size_t j = 1; j <= n; ++j)
                next[j] = row[j - 1] && (*p == s[j - 1] || (*p == '?' && s[j - 1] != '/'));
        }
        std::swap(row, next);
    }
    return row[n];
}

using Choice = std::shared_ptr<const AcceleratorChoice>;

std::unique_ptr<Primitive> build(const Choice& choice, const PrimitiveSet& set) {
    return accelerator(choice->type).build(set, choice->parameters);
}

class Assembler {
  public:
    Assembler(const Scene& scene, const AssemblyPlan& plan) : scene_(scene), plan_(plan) {}

    Assembly run() {
        const auto start = Clock::now();
        resolve_rules();
        if (plan_.bake && !plan_.flatten) standing_ = standing_nodes(scene_);
        result_.root =
            plan_.flatten ? flattened() : group({}, plan_.top, plan_.objects, {}, 0).primitive;
        result_.build_s = seconds_since(start);
        if (result_.inactive_instances > 0)
            result_.warnings.push_back(
                std::to_string(result_.inactive_instances) +
                " instances left out: their transform has no finite inverse");
        if (result_.inactive_shapes > 0)
            result_.warnings.push_back(std::to_string(result_.inactive_shapes) +
                                       " shapes left out: NaN, infinite or without extent");
        return std::move(result_);
    }

  private:
    struct Built {
        std::shared_ptr<const Primitive> primitive;
        uint32_t instances = 0;  ///< mesh instances inside
    };

    /// The rule of each node, by its first path from a root.
    void resolve_rules() {
        rule_of_.assign(scene_.nodes.size(), nullptr);
        std::vector<bool> used(plan_.rules.size(), false), seen(scene_.nodes.size(), false);
        paths_.resize(scene_.nodes.size());
        std::vector<std::pair<uint32_t, int64_t>> open;  // node, parent or -1
        for (auto it = scene_.roots.rbegin(); it != scene_.roots.rend(); ++it)
            open.push_back({*it, -1});
        while (!open.empty()) {
            const auto [n, parent] = open.back();
            open.pop_back();
            if (seen[n]) continue;
            seen[n] = true;
            const Node& node = scene_.nodes[n];
            // Paths of very deep chains are cut: no one names them, and they would grow
            // quadratically.
            if (parent >= 0 && paths_[parent].size() < 4096) paths_[n] = paths_[parent] + "/";
            const std::string& name = node_name(scene_, node);
            paths_[n] += name;
            for (size_t r = 0; r < plan_.rules.size(); ++r) {
                if (!matches(plan_.rules[r].match, name, paths_[n])) continue;
                used[r] = true;
                if (!rule_of_[n]) rule_of_[n] = plan_.rules[r].accelerator;
            }
            for (auto it = node.children.rbegin(); it != node.children.rend(); ++it)
                open.push_back({*it, n});
        }
        for (size_t r = 0; r < plan_.rules.size(); ++r)
            if (!used[r]) refuse(plan_.rules[r]);
    }

    [[noreturn]] void refuse(const AssemblyPlan::Rule& rule) const {
        std::vector<std::string> names;
        for (const Node& node : scene_.nodes)
            if (names.size() < 10000) names.push_back(node_name(scene_, node));
        const std::string near = nearest_name(rule.match, names);
        throw InputError((rule.place.empty() ? "" : rule.place + ": ") + "no node of scene '" +
                         scene_.name + "' matches '" + rule.match + "'" +
                         (near.empty() ? "" : "; did you mean '" + near + "'?"));
    }

    /// A structure over everything below `node` (its own mesh included), or over the whole scene.
    /// @param world_from_node  if it is built in the world, else it is in its own space
    Built group(std::optional<uint32_t> node, const Choice& over, const Choice& objects,
                const std::optional<Transform>& world_from_node, int depth) {
        const auto key = std::make_tuple(node ? int64_t(*node) : -1, over.get(), objects.get());
        if (const auto it = groups_.find(key); it != groups_.end()) return it->second;
        if (depth > 64)
            throw InputError("structures nest deeper than 64 levels at '" + paths_[*node] + "'");

        const bool in_world = !node || world_from_node;
        std::vector<ObjectSet::Object> found;
        ShapeGroups groups;
        uint32_t instances = 0;
        struct Open {
            uint32_t node;
            Transform group_from_node;
            std::optional<size_t> leaves = {};  ///< the end of a node: its group
        };
        std::vector<Open> open;
        const auto push_children = [&](const std::vector<uint32_t>& children, const Transform& t) {
            for (auto it = children.rbegin(); it != children.rend(); ++it)
                open.push_back({*it, t * scene_.nodes[*it].parent_from_node});
        };
        if (node)
            open.push_back({*node, world_from_node.value_or(Transform{})});
        else
            push_children(scene_.roots, {});
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            if (o.leaves) {
                close(groups, *o.leaves, uint32_t(found.size()));
                continue;
            }
            const Node& n = scene_.nodes[o.node];
            const Choice rule = rule_of_[o.node];
            const bool own_group = rule && !n.children.empty() && !(node && o.node == *node);
            if (own_group) {
                const Choice& inside = rule->inside ? rule->inside : objects;
                const bool stays = stands(o.node) && in_world;
                const Built inner =
                    group(o.node, rule, inside,
                          stays ? std::optional(o.group_from_node) : std::nullopt, depth + 1);
                place(found, inner.primitive, stays ? Transform{} : o.group_from_node, instances,
                      inner.instances);
                instances += inner.instances;
                continue;
            }
            open.push_back({o.node, {}, groups.size()});
            groups.push_back({uint32_t(found.size()), 0});
            if (n.mesh) {
                const Choice choice = rule && n.children.empty() ? rule : objects;
                if (in_world && stands(o.node) && is_worth_baking(*n.mesh, o.group_from_node)) {
                    place(found, mesh(*n.mesh, choice, o.node, &o.group_from_node), {}, instances++,
                          1);
                } else {
                    const std::shared_ptr<const Primitive> object = mesh(*n.mesh, choice, o.node);
                    if (n.node_from_instance.empty()) {
                        place(found, object, o.group_from_node, instances++, 1);
                    } else {
                        for (const Transform& t : n.node_from_instance)
                            place(found, object, o.group_from_node * t, instances++, 1);
                    }
                }
            }
            push_children(n.children, o.group_from_node);
        }
        Built built{nullptr, instances};
        // A structure over one object that stands where it is would only cost.
        if (found.size() == 1 && found[0].instance == 0)
            built.primitive = found[0].primitive;
        else
            built.primitive = build(over, objects_of(std::move(found), groups));
        note(node ? paths_[*node] : "(top)", over, instances, *built.primitive);
        if (!node) result_.instances = instances;
        return groups_[key] = built;
    }

    /// Ends a group; one object needs no box around its box.
    static void close(ShapeGroups& groups, size_t group, uint32_t end) {
        if (end - groups[group].first > 1)
            groups[group].end = end;
        else
            groups.resize(group);
    }

    /// The objects as a set, opened as the plan says.
    std::shared_ptr<const ObjectSet> objects_of(std::vector<ObjectSet::Object> found,
                                                const ShapeGroups& groups) {
        if (!(plan_.opening > 1))
            return std::make_shared<const ObjectSet>(std::move(found), groups);
        const size_t before = found.size();
        OpenedObjects opened = open_overlapping(std::move(found), plan_.opening);
        result_.opened += opened.opened;
        result_.parts += opened.objects.size() - before + opened.opened;
        return std::make_shared<const ObjectSet>(std::move(opened.objects),
                                                 moved_groups(groups, opened));
    }

    void place(std::vector<ObjectSet::Object>& found, std::shared_ptr<const Primitive> object,
               const Transform& t, uint32_t instance, uint32_t count) {
        if (!object || object->bounds().empty()) return;
        if (t.is_identity()) {
            found.push_back({std::move(object), instance});
        } else if (Instance::is_valid(t)) {
            found.push_back({std::make_shared<const Instance>(std::move(object), t), instance});
        } else {
            result_.inactive_instances += count;
        }
    }

    bool stands(uint32_t node) const { return !standing_.empty() && standing_[node]; }
    bool is_worth_baking(uint32_t m, const Transform& t) const {
        // Boxes in the world may be so much larger for what an instance costs.
        constexpr double most = 1.3;
        return !t.is_identity() && Instance::is_valid(t) && area_ratio(scene_, m, t) <= most;
    }

    /// One mesh in its own space: a structure for each kind of shape, and one over these if
    /// several.
    /// @param world_from_object  if it is not null, the mesh is built in the world
    std::shared_ptr<const Primitive> mesh(uint32_t m, const Choice& choice, uint32_t node,
                                          const Transform* world_from_object = nullptr) {
        const auto key = std::make_pair(m, choice.get());
        if (const auto it = meshes_.find(key); it != meshes_.end()) {
            if (it->second.entry < result_.entries.size())
                ++result_.entries[it->second.entry].placements;
            return it->second.primitive;
        }
        ShapeSetBuilder builder(scene_);
        builder.add_mesh(m, world_from_object, 0);
        std::shared_ptr<const Primitive> primitive = over_sets(builder, choice, {});
        meshes_[key] = {primitive, result_.entries.size()};
        note(paths_[node], choice, builder.shapes(), *primitive);
        return primitive;
    }

    /// Structures over the sets that `builder` holds, with `others` beside them.
    std::shared_ptr<const Primitive> over_sets(ShapeSetBuilder& builder, const Choice& choice,
                                               std::vector<ObjectSet::Object> others) {
        result_.triangles += builder.triangles();
        std::vector<PrimitiveSet> sets = builder.take();
        for (const PrimitiveSet& set : sets) count_inactive(set);
        if (sets.size() == 1 && others.empty()) return build(choice, sets[0]);
        for (const PrimitiveSet& set : sets) others.push_back({build(choice, set), 0});
        return build(choice, std::make_shared<const ObjectSet>(std::move(others)));
    }

    /// Everything in one set of each kind, transforms baked; what cannot be baked stays an
    /// instance.
    std::shared_ptr<const Primitive> flattened() {
        ShapeSetBuilder builder(scene_);
        std::vector<ObjectSet::Object> others;
        const std::vector<MeshInstance> placed = mesh_instances(scene_);
        std::vector<uint32_t> first_triangle;
        builder.reserve(placed);
        for (uint32_t i = 0; i < placed.size(); ++i) {
            const MeshInstance& p = placed[i];
            first_triangle.push_back(uint32_t(builder.triangles()));
            const bool identity = p.world_from_object.is_identity();
            if (!identity && !Instance::is_valid(p.world_from_object)) {
                ++result_.inactive_instances;
                continue;
            }
            if (builder.add_mesh(p.mesh, identity ? nullptr : &p.world_from_object, i)) continue;
            // Quadrics and polygons are tested in their own space: theirs is a nested object.
            place(others, mesh_without_triangles(p.mesh), p.world_from_object, i, 1);
        }
        first_triangle.push_back(uint32_t(builder.triangles()));
        ShapeGroups groups = placement_groups(scene_);
        for (ShapeGroup& g : groups) g = {first_triangle[g.first], first_triangle[g.end]};
        builder.group_triangles(std::move(groups));
        result_.instances = placed.size();
        std::shared_ptr<const Primitive> root = over_sets(builder, plan_.top, std::move(others));
        note("(top)", plan_.top, builder.shapes(), *root);
        return root;
    }

    std::shared_ptr<const Primitive> mesh_without_triangles(uint32_t m) {
        const auto key = std::make_pair(m, static_cast<const AcceleratorChoice*>(nullptr));
        if (const auto it = meshes_.find(key); it != meshes_.end()) return it->second.primitive;
        ShapeSetBuilder builder(scene_);
        builder.add_mesh(m, nullptr, 0, ShapeSetBuilder::all_but_triangles);
        meshes_[key] = {over_sets(builder, plan_.objects, {}), SIZE_MAX};
        return meshes_[key].primitive;
    }

    void count_inactive(const PrimitiveSet& set) {
        constexpr size_t grain = 1 << 14;
        std::atomic<uint64_t> inactive = 0;
        std::visit(
            [&](const auto& s) {
                parallel_for(s->size(), grain, [&](size_t begin, size_t end) {
                    uint64_t count = 0;
                    for (size_t i = begin; i < end; ++i) count += !s->active(uint32_t(i));
                    inactive += count;
                });
            },
            set);
        result_.inactive_shapes += inactive;
    }

    void note(const std::string& path, const Choice& choice, uint64_t shapes, const Primitive& p) {
        result_.entries.push_back(
            {path, choice->label, p.type_name(), shapes, p.statistics().bytes, 1});
    }

    struct BuiltMesh {
        std::shared_ptr<const Primitive> primitive;
        size_t entry;
    };
    const Scene& scene_;
    const AssemblyPlan& plan_;
    Assembly result_;
    std::vector<Choice> rule_of_;
    std::vector<std::string> paths_;
    std::vector<bool> standing_;  ///< of each node; empty: none matters
    std::map<std::pair<uint32_t, const AcceleratorChoice*>, BuiltMesh> meshes_;
    std::map<std::tuple<int64_t, const AcceleratorChoice*, const AcceleratorChoice*>, Built>
        groups_;
};

}  // namespace

bool matches(const std::string& pattern, const std::string& name, const std::string& path) {
    if (pattern == name || pattern == path) return true;
    if (pattern.find_first_of("*?") == std::string::npos) return false;
    const std::string& text =
        pattern.find('/') == std::string::npos && pattern != "**" ? name : path;
    return glob(pattern.data(), pattern.data() + pattern.size(), text.data(),
                text.data() + text.size());
}

Assembly assemble(const Scene& scene, const AssemblyPlan& plan) {
    return Assembler(scene, plan).run();
}

}  // namespace crofton
