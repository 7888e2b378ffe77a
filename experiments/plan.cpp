#include "experiments/plan.h"

#include <algorithm>

#include "framework/error.h"
#include "framework/registry.h"
#include "scenegraph/auto_plan.h"

namespace crofton {
namespace {

using ChoicePointer = std::shared_ptr<const AcceleratorChoice>;

/// The accelerators of a config, resolved by name; a registry name that no table defines stands for
/// that accelerator with its defaults.
class Choices {
  public:
    explicit Choices(ConfigTable table) : table_(std::move(table)) {
        for (const ConfigValue& item : table_.raw().items) names_.push_back(item.key);
        for (const std::string& name : names_) resolve(name, {});
    }

    /// @param at  value that holds the name, for messages
    ChoicePointer get(const std::string& name, const ConfigValue& at) {
        if (std::find(names_.begin(), names_.end(), name) != names_.end()) return resolve(name, {});
        const auto& registered = accelerators();
        if (registered.contains(name) || peers().contains(name)) {
            const auto choice = std::make_shared<AcceleratorChoice>();
            choice->label = choice->type = name;
            return choice;
        }
        std::vector<std::string> candidates = names_;
        for (const auto& [type, info] : registered)
            if (std::find(names_.begin(), names_.end(), type) == names_.end())
                candidates.push_back(type);
        throw InputError(at.place + ": " + unknown_name("accelerator", name, candidates));
    }

  private:
    /// `open` are the accelerators that wait for this one; its length is bounded by their number.
    ChoicePointer resolve(const std::string& name, std::vector<std::string> open) {
        if (const auto found = done_.find(name); found != done_.end()) return found->second;
        ConfigTable table = table_.table(name);
        const auto choice = std::make_shared<AcceleratorChoice>();
        choice->label = name;
        const auto type = table.string("type");
        if (!type) table.fail("type", table.what() + ": missing key 'type'");
        if (!accelerators().contains(*type) && !peers().contains(*type))
            table.fail("type", unknown_name("accelerator", *type, accelerator_names()));
        choice->type = *type;
        read_parameters(table, *choice);
        open.push_back(name);
        if (const auto inside = table.string("inside")) {
            const ConfigValue& at = *table.raw().find("inside");
            check_cycle(*inside, open, at);
            const bool named = std::find(names_.begin(), names_.end(), *inside) != names_.end();
            choice->inside = named ? resolve(*inside, open) : get(*inside, at);
        }
        table.finish();
        return done_[name] = choice;
    }

    static void check_cycle(const std::string& inside, const std::vector<std::string>& open,
                            const ConfigValue& at) {
        const auto first = std::find(open.begin(), open.end(), inside);
        if (first == open.end()) return;
        std::string cycle;
        for (auto it = first; it != open.end(); ++it) cycle += *it + " → ";
        throw InputError(at.place + ": inside: a cycle: " + cycle + inside);
    }

    static void read_parameters(ConfigTable& table, AcceleratorChoice& choice) {
        for (const ParameterInfo& info : accelerator(choice.type).parameters) {
            const ConfigValue* value = table.value(info.name);
            if (!value) {
                table.raw().set(info.name, ConfigValue::of(info.default_value));
                continue;
            }
            const auto scalar = value->scalar();
            if (!scalar)
                table.fail(info.name,
                           info.name + ": expected a single value, found " + value->type_text());
            try {
                choice.parameters[info.name] = checked(info, *scalar);
            } catch (const InputError& error) {
                table.fail(info.name, error.what());
            }
        }
    }

    ConfigTable table_;
    std::vector<std::string> names_;
    std::map<std::string, ChoicePointer> done_;
};

/// The keys that [assign] and [[variant]] share.
struct Assignment {
    ChoicePointer top, objects;
    bool flatten = false;
    double opening = 0;
    bool bake = true;
    std::vector<AssemblyPlan::Rule> rules;
    bool given = false;  ///< says anything at all
};

ChoicePointer read_choice(ConfigTable& table, const std::string& key, const ChoicePointer& fallback,
                          Choices& choices) {
    const auto name = table.string(key);
    return name ? choices.get(*name, *table.raw().find(key)) : fallback;
}

std::string required_string(ConfigTable& table, const std::string& key) {
    const auto text = table.string(key);
    if (!text) table.fail(key, table.what() + ": missing key '" + key + "'");
    return *text;
}

std::vector<AssemblyPlan::Rule> read_rules(ConfigTable& table, Choices& choices) {
    std::vector<AssemblyPlan::Rule> rules;
    for (ConfigTable& node : table.tables("node")) {
        AssemblyPlan::Rule rule;
        rule.match = required_string(node, "match");
        rule.place = node.raw().find("match")->place;
        const std::string name = required_string(node, "accelerator");
        rule.accelerator = choices.get(name, *node.raw().find("accelerator"));
        node.finish();
        rules.push_back(std::move(rule));
    }
    return rules;
}

Assignment read_assignment(ConfigTable& table, const Assignment& base, Choices& choices) {
    Assignment out;
    out.top = read_choice(table, "top", base.top, choices);
    out.objects = read_choice(table, "default", base.objects, choices);
    out.flatten = table.boolean("flatten", base.flatten);
    out.opening = table.real("opening", base.opening, 0, 1000);
    out.bake = table.boolean("bake", base.bake);
    out.rules = read_rules(table, choices);
    if (out.flatten && !out.rules.empty())
        table.fail("node", table.what() + ": a flattened scene has no nodes to match");
    // By value: defaults are written back, and a resolved config must mean the same.
    out.given = base.given || table.has("top") || table.has("default") || out.flatten ||
                out.opening > 1 || !out.bake || !out.rules.empty();
    // A variant's own rules come first, so that they win.
    if (!out.flatten) out.rules.insert(out.rules.end(), base.rules.begin(), base.rules.end());
    return out;
}

/// Notes whether a plan holds peers, and whether all of them are there.
void look_for_peers(Variant& variant) {
    const auto look = [&](const ChoicePointer& choice) {
        for (const AcceleratorChoice* at = choice.get(); at; at = at->inside.get()) {
            const auto peer = peers().find(at->type);
            if (peer == peers().end()) continue;
            variant.peer = true;
            if (!peer->second.build) variant.available = false;
        }
    };
    look(variant.plan.top);
    if (!variant.plan.flatten) look(variant.plan.objects);
    for (const auto& rule : variant.plan.rules) look(rule.accelerator);
}

/// Of a variant; nothing if it has none of its own.
std::optional<Mode> read_mode(ConfigTable& table) {
    if (!table.has("mode")) return std::nullopt;
    const auto names = mode_names();
    return mode_named(table.string("mode", "", {names.begin(), names.end()}));
}

/// Whether an accelerator of the plan may end rays early: its parameter `lod` is above 0.
bool has_lod(const AssemblyPlan& plan) {
    std::vector<const AcceleratorChoice*> open{plan.top.get(), plan.objects.get()};
    for (const auto& rule : plan.rules) open.push_back(rule.accelerator.get());
    for (const AcceleratorChoice* choice : open)
        for (; choice; choice = choice->inside.get())
            if (const auto lod = choice->parameters.find("lod"); lod != choice->parameters.end())
                if (std::get<double>(lod->second) > 0) return true;
    return false;
}

Variant make_variant(const std::string& name, const Assignment& assignment) {
    Variant variant;
    variant.name = name;
    if (!assignment.given) {
        variant.plan = uniform_plan("auto");
        variant.canonical = canonical(variant.plan);
        variant.chooses = true;
        return variant;
    }
    variant.plan = {assignment.top,     assignment.objects, assignment.flatten,
                    assignment.opening, assignment.bake,    assignment.rules};
    variant.canonical = canonical(variant.plan);
    variant.exact = !has_lod(variant.plan);
    variant.chooses = chooses_all(variant.plan);
    look_for_peers(variant);
    return variant;
}

}  // namespace

std::string canonical(const AcceleratorChoice& choice) {
    std::string text;
    // Chains of `inside` have no cycle; see Choices.
    for (const AcceleratorChoice* at = &choice; at; at = at->inside.get()) {
        text += (text.empty() ? "" : ">") + at->type + "{";
        for (const ParameterInfo& info : accelerator(at->type).parameters) {
            const auto found = at->parameters.find(info.name);
            text += info.name + "=" +
                    to_string(found == at->parameters.end() ? info.default_value : found->second) +
                    ",";
        }
        text += "}";
    }
    return text;
}

std::string canonical(const AssemblyPlan& plan) {
    std::string text = "top=" + canonical(*plan.top);
    if (plan.flatten) return text + ";flat";
    text += ";default=" + canonical(*plan.objects);
    if (!plan.bake) text += ";own spaces";
    if (plan.opening > 1) text += ";opening=" + to_string(ParameterValue(plan.opening));
    for (const auto& rule : plan.rules)
        text += ";" + rule.match + "=" + canonical(*rule.accelerator);
    return text;
}

std::vector<Variant> parse_variants(ConfigTable& root) {
    Choices choices(root.table("accelerator"));
    Assignment standard;
    standard.top = standard.objects = choices.get("bvh", root.raw());
    ConfigTable assign = root.table("assign");
    const Assignment base = read_assignment(assign, standard, choices);
    assign.finish();
    std::vector<Variant> variants;
    for (ConfigTable& table : root.tables("variant")) {
        const std::string name = required_string(table, "name");
        Variant variant = make_variant(name, read_assignment(table, base, choices));
        variant.max_rays = table.integer("max_rays", 1, int64_t{1} << 40);
        variant.mode = read_mode(table);
        variant.single = table.boolean("single", false);
        table.finish();
        for (const Variant& other : variants)
            if (other.name == name) table.fail("name", "two variants are named '" + name + "'");
        variants.push_back(std::move(variant));
    }
    if (variants.empty()) variants.push_back(make_variant("default", base));
    return variants;
}

AssemblyPlan uniform_plan(const std::string& accelerator_name) {
    const auto choice = std::make_shared<AcceleratorChoice>();
    choice->type = accelerator(accelerator_name).name;
    choice->label = accelerator_name;
    AssemblyPlan plan;
    plan.top = plan.objects = choice;
    return plan;
}

namespace {

/// The plan with `change` applied to a copy of every accelerator, those inside included.
template <class Change>
AssemblyPlan changed(const AssemblyPlan& plan, const Change& change) {
    std::map<const AcceleratorChoice*, ChoicePointer> done{{nullptr, nullptr}};
    const auto filled = [&](const ChoicePointer& first) {
        // From the end of a chain of `inside`, so that every link points at a filled one.
        std::vector<const AcceleratorChoice*> chain;
        for (const AcceleratorChoice* at = first.get(); at; at = at->inside.get())
            chain.push_back(at);
        for (auto at = chain.rbegin(); at != chain.rend(); ++at) {
            if (done.contains(*at)) continue;
            auto copy = std::make_shared<AcceleratorChoice>(**at);
            copy->inside = done.at((*at)->inside.get());
            change(*copy);
            done[*at] = copy;
        }
        return done.at(first.get());
    };
    AssemblyPlan out = plan;
    out.top = filled(plan.top);
    out.objects = filled(plan.objects);
    for (AssemblyPlan::Rule& rule : out.rules) rule.accelerator = filled(rule.accelerator);
    return out;
}

}  // namespace

AssemblyPlan with_pixel_angle(const AssemblyPlan& plan, double angle) {
    return changed(plan, [&](AcceleratorChoice& choice) {
        if (!accelerator(choice.type).find("pixel_angle")) return;
        ParameterValue& value = choice.parameters.try_emplace("pixel_angle", 0.0).first->second;
        if (std::get<double>(value) == 0) value = angle;
    });
}

AssemblyPlan with_objective(const AssemblyPlan& plan, const Objective& objective) {
    static const std::string priorities[] = {"total", "trace", "build"};
    return changed(plan, [&](AcceleratorChoice& choice) {
        if (choice.type != "auto") return;
        choice.parameters.try_emplace("rays", objective.rays);
        choice.parameters.try_emplace("memory", objective.memory);
        choice.parameters.try_emplace("priority", priorities[int(objective.priority)]);
    });
}

}  // namespace crofton
