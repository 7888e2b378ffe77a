#include "framework/exact_number.h"

#include <bit>
#include <cstdint>

namespace crofton::exact {
namespace {

/// Floats in order as integers: consecutive floats are consecutive, both zeros are 0.
int64_t ordinal(float f) {
    const int32_t bits = std::bit_cast<int32_t>(f);
    return bits >= 0 ? bits : -int64_t(bits & 0x7fffffff);
}

float from_ordinal(int64_t n) {
    return std::bit_cast<float>(n >= 0 ? uint32_t(n) : 0x80000000u | uint32_t(-n));
}

/// Where rounding turns from `from_ordinal(n)` to the next: a double, as floats have 29 bits less.
/// Beyond the largest float it is half a step of the last binade, 2^128 - 2^103.
double border_above(int64_t n) {
    const float low = from_ordinal(n), high = from_ordinal(n + 1);
    if (std::isinf(high)) return 0x1.ffffffp127;
    if (std::isinf(low)) return -0x1.ffffffp127;
    return (double(low) + double(high)) / 2;
}

double approximate(const Root& x) {
    double fa, fb, fc;
    int ea, eb, ec;
    x.a.approximate(fa, ea);
    x.b.approximate(fb, eb);
    x.c.approximate(fc, ec);
    double result = std::ldexp(fa / fc, ea - ec);
    if (x.s != 0 && fb != 0) {
        if (eb & 1) fb *= 2, --eb;
        result += std::ldexp(x.s * std::sqrt(fb) / fc, eb / 2 - ec);
    }
    return result;
}

}  // namespace

Dyadic::Dyadic(double x) {
    if (x == 0) return;
    const uint64_t bits = std::bit_cast<uint64_t>(x);
    const int biased = int(bits >> 52 & 0x7ff);
    uint64_t m = bits & ((uint64_t{1} << 52) - 1);
    if (biased) m |= uint64_t{1} << 52;
    const int zeros = std::countr_zero(m);
    m_ = m >> zeros;
    if (x < 0) m_ = -m_;
    e_ = (biased ? biased : 1) - 1075 + zeros;
}

Dyadic Dyadic::sum(const Dyadic& a, const Dyadic& b, bool negate) {
    if (b.m_.is_zero()) return a;
    if (a.m_.is_zero()) return negate ? -b : b;
    Dyadic r;
    r.e_ = std::min(a.e_, b.e_);
    if (a.e_ > b.e_) {
        r.m_ = a.m_ << (a.e_ - b.e_);
        negate ? r.m_ -= b.m_ : r.m_ += b.m_;
    } else if (a.e_ < b.e_) {
        r.m_ = b.m_ << (b.e_ - a.e_);
        if (negate) r.m_ = -r.m_;
        r.m_ += a.m_;
    } else {
        r.m_ = negate ? Integer(a.m_ - b.m_) : Integer(a.m_ + b.m_);
    }
    return r;
}

Dyadic operator+(const Dyadic& a, const Dyadic& b) { return Dyadic::sum(a, b, false); }
Dyadic operator-(const Dyadic& a, const Dyadic& b) { return Dyadic::sum(a, b, true); }
Dyadic operator*(const Dyadic& a, const Dyadic& b) { return {a.m_ * b.m_, a.e_ + b.e_}; }
Dyadic Dyadic::operator-() const { return {-m_, e_}; }

void Dyadic::approximate(double& fraction, int& exponent) const {
    fraction = 0;
    exponent = 0;
    if (m_.is_zero()) return;
    const Integer magnitude = m_.sign() < 0 ? Integer(-m_) : m_;
    const int bits = int(boost::multiprecision::msb(magnitude)) + 1;
    const int cut = std::max(0, bits - 64);
    const uint64_t top = static_cast<uint64_t>(magnitude >> cut);
    int e;
    fraction = std::frexp(m_.sign() * double(top), &e);
    exponent = e + cut + e_;
}

double Dyadic::to_double() const {
    double f;
    int e;
    approximate(f, e);
    return std::ldexp(f, e);
}

Root Root::fraction(Dyadic a, Dyadic c) {
    if (c.sign() < 0) return {-a, {}, -c, 0};
    return {std::move(a), {}, std::move(c), 0};
}

int sign_of(const Dyadic& p, const Dyadic& q, const Dyadic& x) {
    const int sp = p.sign(), sq = x.sign() == 0 ? 0 : q.sign();
    if (sq == 0) return sp;
    if (sp == 0 || sp == sq) return sq;
    return sp * compare(square(p), square(q) * x);
}

int compare(const Root& x, const Root& y) {
    // p + q·√xb + r·√yb, after both are multiplied by the denominators.
    const Dyadic p = x.a * y.c - y.a * x.c;
    const Dyadic q = x.s == 0 ? Dyadic() : x.s > 0 ? y.c : -y.c;
    if (y.s == 0) return sign_of(p, q, x.b);
    const Dyadic r = y.s > 0 ? -x.c : x.c;
    const int left = sign_of(p, q, x.b), right = y.b.sign() == 0 ? 0 : r.sign();
    if (right == 0) return left;
    if (left == 0 || left == right) return right;
    // The squares of p + q·√xb and of r·√yb.
    return left * sign_of(square(p) + square(q) * x.b - square(r) * y.b, Dyadic(2) * p * q, x.b);
}

int compare(const Root& x, double y) {
    if (std::isinf(y)) return y > 0 ? -1 : 1;
    return sign_of(x.a - Dyadic(y) * x.c, Dyadic(x.s), x.b);
}

float round_to_float(const Root& x) {
    const int64_t last = ordinal(std::numeric_limits<float>::infinity());
    // The answer is the first n with x <= the border above it. One step around the estimate nearly
    // always holds it; else the search takes all floats.
    const float guess = float(approximate(x));
    int64_t low = -last, high = last;
    if (!std::isnan(guess)) {
        const int64_t n = ordinal(guess);
        if (n - 2 >= -last && compare(x, border_above(n - 2)) > 0) low = n - 1;
        if (n + 1 <= last - 1 && compare(x, border_above(n + 1)) <= 0) high = n + 1;
    }
    while (low < high) {
        const int64_t middle = low + (high - low) / 2;
        if (compare(x, border_above(middle)) <= 0)
            high = middle;
        else
            low = middle + 1;
    }
    // A tie goes to the even one: the border belongs to `low`, unless that is odd.
    if (low < last && (low & 1) && compare(x, border_above(low)) == 0) ++low;
    return from_ordinal(low);
}

}  // namespace crofton::exact
