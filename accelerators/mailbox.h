#pragma once

#include <cstdint>
#include <cstring>

namespace crofton {

/// Remembers which shapes one ray has tested, so that a shape that stands in several cells is
/// tested once (Amanatides & Woo 1987). Lives on the stack of the ray: a small direct-mapped table
/// (Shevtsov 2007 calls it inverse mailboxing); what falls out of it is tested again, which changes
/// nothing.
class Mailbox {
  public:
    Mailbox() { std::memset(seen_, 0xff, sizeof seen_); }
    /// Copies the references not seen before to `fresh` (room for `count`) and returns their
    /// number.
    uint32_t filter(const uint32_t* references, uint32_t count, uint32_t* fresh) {
        uint32_t n = 0;
        for (uint32_t i = 0; i < count; ++i) {
            uint32_t& slot = seen_[references[i] % size];
            fresh[n] = references[i];
            n += slot != references[i];
            slot = references[i];
        }
        return n;
    }
    /// Calls test(fresh references, their number) -> bool until one says true, and returns whether.
    template <class Test>
    bool test_fresh(const uint32_t* references, uint32_t count, Test&& test) {
        uint32_t fresh[size];
        for (uint32_t i = 0; i < count; i += size) {
            const uint32_t n = filter(references + i, count - i < size ? count - i : size, fresh);
            if (n > 0 && test(fresh, n)) return true;
        }
        return false;
    }

  private:
    static constexpr uint32_t size = 64;
    uint32_t seen_[size];
};

/// The same interface, remembering nothing.
struct NoMailbox {
    template <class Test>
    bool test_fresh(const uint32_t* references, uint32_t count, Test&& test) {
        return test(references, count);
    }
};

enum class MailboxMode { off, on, automatic };

/// Auto: a table lookup costs about a nanosecond a reference, a repeated test its cost.
/// @param nested  shapes are objects: to enter one twice always costs more than the lookup
inline bool wants_mailbox(MailboxMode mode, bool nested, double references, double shapes,
                          double mean_cost) {
    if (mode != MailboxMode::automatic) return mode == MailboxMode::on;
    if (nested) return references > shapes;
    return references > 1.5 * shapes && mean_cost > 4.0;
}

}  // namespace crofton
