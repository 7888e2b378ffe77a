#pragma once

#include <map>
#include <string>
#include <vector>

namespace crofton {

/// The processor, as the system names it; "unknown" if it does not.
std::string cpu_model();

/// What a machine's times are known for: its processor, the instruction set that kernels use, and
/// the program. Times of another are not to be used.
struct MachineIdentity {
    std::string cpu;      ///< see cpu_model
    std::string isa;      ///< see active_isa
    std::string version;  ///< of crofton
    int threads = 0;      ///< that builds use

    /// Of this machine as it is set up now. @param version  see version_text
    static MachineIdentity here(const std::string& version);
    bool operator==(const MachineIdentity&) const = default;
    /// 16 hexadecimal digits that tell identities apart.
    std::string hash() const;
};

/// One measured cost, with an interval that holds its median with 95 %.
struct MeasuredCost {
    double ns = 0, low = 0, high = 0;
};

/// A dependent load that the cache of this size still holds.
struct MemoryLevel {
    std::string name;   ///< "L1", "L2", "L3", "memory"
    double bytes = 0;   ///< of the set that was walked
    MeasuredCost load;  ///< ns per load
};

/// What a structure costs at one number of shapes: geometric means over the calibration scenes.
struct GrowthPoint {
    double shapes = 0;
    double build_ns = 0;  ///< per shape
    double bytes = 0;     ///< per shape
    double ray_ns = 0;    ///< per ray that meets the bounds
    /// ns per ray over ray_ns, which is a mean over all: of rays from one point, as from a camera,
    /// neighbours together, and of all others. The finer the shapes, the less neighbours gain.
    double together = 1, apart = 1;
};

/// A structure's costs over one kind of shape, as they grow; between points they are interpolated
/// on logarithmic axes, beyond them the last slope goes on.
struct StructureCosts {
    std::string structure;            ///< see StructureChoice::name
    std::string shapes;               ///< "triangles", "quadrics" or "polygons"
    std::vector<GrowthPoint> growth;  ///< ascending in shapes, at least one
    /// Standard deviation of ln(ns per ray / that of a wide_bvh) between scenes of one size.
    double ray_spread = 0;
    double build_spread = 0;  ///< of ln(build_ns) between scenes of one size

    /// Nanoseconds of a ray alone from counters: per_ray + (per_step·N_TS + per_test·N_IT)·f, f = 1
    /// + per_doubling·log2(bytes / what the second cache holds) beyond that cache, else 1.
    double per_ray = 0, per_step = 0, per_test = 0, per_doubling = 0;
    double fit_error = 0;  ///< median |predicted / measured - 1| over the calibration's own scenes
    /// Time over counted_ns of neighbours from one point, which may go together; of others 1.
    double counted_together = 1;

    /// Of a scene over itself thinned (see thinned): ns per ray grow with these powers of the
    /// numbers of shapes, of rays that go apart, and of neighbours together, of which more pass as
    /// one in a thinned scene; and seconds of the build.
    double thin_apart = 0.15, thin_together = 0.05, thin_build = 1;

    /// Share of a ray's time that tests of shapes take: what rays cost more where shapes are dearer
    /// to test than the calibration's.
    double test_share = 0;

    /// At any number of shapes >= 1.
    GrowthPoint at(double shapes) const;
    /// Nanoseconds of a ray with such counts. @param cache_bytes  what the second cache holds
    double counted_ns(double steps, double tests, double bytes, double cache_bytes) const;
};

/// Costs of one machine. The constants of framework/cost.h, which builders weigh nodes with, stay
/// fixed, so that structures are the same everywhere: these serve to predict and to choose.
struct Calibration {
    MachineIdentity machine;
    double measured_s = 0;                          ///< that it took
    double cache_bytes = 1 << 20;                   ///< of the second level
    std::map<std::string, MeasuredCost> constants;  ///< ns, by name
    std::vector<MemoryLevel> memory;                ///< nearest first
    std::vector<StructureCosts> structures;

    /// @return  null if there is nothing about them
    const StructureCosts* find(const std::string& structure, const std::string& shapes) const;

    /// Typical values, for where nothing was measured: of one core of the Zen 5 kind.
    static const Calibration& nominal();
};

/// $XDG_CACHE_HOME/crofton/calibration-HASH.toml, or below ~/.cache.
std::string calibration_path(const MachineIdentity& machine);

/// The file's text.
std::string to_toml(const Calibration& calibration);
/// @throws InputError  cannot be read, or is not a calibration: "file:line:column: what"
Calibration read_calibration(const std::string& path);
/// Makes the folders it needs. @throws InputError  cannot be written
void write_calibration(const Calibration& calibration, const std::string& path);

/// What choices are made with from now on; `nominal` until it is set. Not thread-safe.
void set_calibration(Calibration calibration);
const Calibration& calibration();

}  // namespace crofton
