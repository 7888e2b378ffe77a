#pragma once

#include <string>
#include <utility>

#include "framework/error.h"
#include "framework/primitive.h"

namespace crofton {

/// A structure of another library: it counts nothing, shows only its box, and cannot be saved.
class PeerObject : public Primitive {
  public:
    using Primitive::any_local;
    using Primitive::closest_local;
    void closest_local(const LocalRay& ray, RayQuery& q, Counters&) const final {
        closest_local(ray, q);
    }
    bool any_local(const LocalRay& ray, RayQuery& q, Counters&) const final {
        return any_local(ray, q);
    }
    double expected_cost() const final { return 0; }
    StructureStatistics statistics() const final {
        StructureStatistics s;
        s.bytes = bytes();
        return s;
    }
    std::string type_name() const final { return name_; }
    void walk(const BoxVisitor& visit) const final { visit(bounds(), 0, true, 0); }
    void children(const std::function<void(const Primitive&)>&) const override {}
    void archive(StructureWriter&) const final {
        throw InputError(name_ + ": a peer's structure cannot be saved");
    }

  protected:
    /// @param name  as registered
    template <class Set>
    PeerObject(std::string name, const Set& set) : name_(std::move(name)) {
        Bounds3 bounds;
        for (uint32_t i = 0; i < set.size(); ++i)
            if (set.active(i)) bounds.extend(set.bounds(i));
        set_bounds(bounds);
    }
    virtual uint64_t bytes() const = 0;

  private:
    std::string name_;
};

}  // namespace crofton
