#pragma once

#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <limits>

namespace crofton::exact {

/// A real number m·2^e with an integer m of any length: every float and double is one, and sums,
/// differences and products of them are again, without rounding. There is no division; fractions
/// are compared across.
///
/// Boost's integers with 512 bits inline: measured on the edge signs of random triangles they take
/// two thirds of the time of GMP's, whose every number is an allocation.
class Dyadic {
  public:
    using Integer = boost::multiprecision::number<
        boost::multiprecision::cpp_int_backend<512, 0, boost::multiprecision::signed_magnitude,
                                               boost::multiprecision::unchecked,
                                               std::allocator<boost::multiprecision::limb_type>>,
        boost::multiprecision::et_off>;

    Dyadic() = default;
    /// @param x  finite
    Dyadic(double x);  // NOLINT: a double is a dyadic number

    friend Dyadic operator+(const Dyadic& a, const Dyadic& b);
    friend Dyadic operator-(const Dyadic& a, const Dyadic& b);
    friend Dyadic operator*(const Dyadic& a, const Dyadic& b);
    Dyadic operator-() const;
    int sign() const { return m_.sign(); }
    /// Within a relative 2^-52: fraction·2^exponent, |fraction| in [1/2, 1], or 0.
    void approximate(double& fraction, int& exponent) const;
    double to_double() const;

    const Integer& mantissa() const { return m_; }
    int exponent() const { return e_; }

  private:
    Dyadic(Integer m, int e) : m_(std::move(m)), e_(e) {}
    static Dyadic sum(const Dyadic& a, const Dyadic& b, bool negate);

    Integer m_ = 0;
    int e_ = 0;
};

inline int compare(const Dyadic& a, const Dyadic& b) { return (a - b).sign(); }

/// (a + s·√b)/c: where a ray meets a surface of degree one (s = 0) or two.
struct Root {
    Dyadic a, b, c;  ///< b >= 0, c > 0
    int s = 0;       ///< -1, 0, 1

    /// a/c, c ≠ 0 of any sign.
    static Root fraction(Dyadic a, Dyadic c);
};

/// Sign of p + q·√x, x >= 0.
int sign_of(const Dyadic& p, const Dyadic& q, const Dyadic& x);
/// Sign of x - y.
int compare(const Root& x, const Root& y);
/// Sign of x - y, y not NaN.
int compare(const Root& x, double y);
/// To nearest, ties to even, overflow to infinity: what an exact real number is as a float.
float round_to_float(const Root& x);

/// All numbers between lo and hi. Operations contain the exact result for all operands within:
/// every rounded bound is moved outwards by more than its rounding error, 2^-53 of itself or
/// 2^-1075. An overflow or NaN ends in a bound that decides nothing.
struct Interval {
    double lo = 0, hi = 0;

    Interval() = default;
    Interval(double x) : lo(x), hi(x) {}  // NOLINT: a double is an interval
    Interval(double l, double h) : lo(l), hi(h) {}
    static Interval around(double x, double radius) { return outward(x - radius, x + radius); }

    /// Surely positive, 1; surely negative, -1; else 0.
    int sign() const { return lo > 0 ? 1 : hi < 0 ? -1 : 0; }
    double magnitude() const { return std::max(std::abs(lo), std::abs(hi)); }

    static double down(double x) { return x - (std::abs(x) * 0x1p-51 + 0x1p-1070); }
    static double up(double x) { return x + (std::abs(x) * 0x1p-51 + 0x1p-1070); }
    static Interval outward(double l, double h) { return {down(l), up(h)}; }

    friend Interval operator+(const Interval& a, const Interval& b) {
        return outward(a.lo + b.lo, a.hi + b.hi);
    }
    friend Interval operator-(const Interval& a, const Interval& b) {
        return outward(a.lo - b.hi, a.hi - b.lo);
    }
    Interval operator-() const { return {-hi, -lo}; }
    friend Interval operator*(const Interval& a, const Interval& b) {
        const double p = a.lo * b.lo, q = a.lo * b.hi, r = a.hi * b.lo, s = a.hi * b.hi;
        return outward(std::min(std::min(p, q), std::min(r, s)),
                       std::max(std::max(p, q), std::max(r, s)));
    }
    /// @param b  does not contain 0
    friend Interval operator/(const Interval& a, const Interval& b) {
        const double p = a.lo / b.lo, q = a.lo / b.hi, r = a.hi / b.lo, s = a.hi / b.hi;
        return outward(std::min(std::min(p, q), std::min(r, s)),
                       std::max(std::max(p, q), std::max(r, s)));
    }
    bool valid() const { return lo <= hi; }
};

/// x², narrower than x·x where x contains 0.
inline Interval square(const Interval& x) {
    const Interval y = x * x;
    return x.lo < 0 && x.hi > 0 ? Interval(0, y.hi) : Interval(std::max(0.0, y.lo), y.hi);
}
inline Dyadic square(const Dyadic& x) { return x * x; }
/// Of the part of x that is not negative.
inline Interval sqrt(const Interval& x) {
    const Interval y =
        Interval::outward(std::sqrt(std::max(0.0, x.lo)), std::sqrt(std::max(0.0, x.hi)));
    return {std::max(0.0, y.lo), y.hi};
}

/// Three numbers of either kind.
template <class N>
struct Triple {
    N x[3];
    N& operator[](int a) { return x[a]; }
    const N& operator[](int a) const { return x[a]; }
    friend Triple operator-(const Triple& a, const Triple& b) {
        return {{a[0] - b[0], a[1] - b[1], a[2] - b[2]}};
    }
    friend Triple operator+(const Triple& a, const Triple& b) {
        return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}};
    }
    friend Triple operator*(const N& s, const Triple& a) {
        return {{s * a[0], s * a[1], s * a[2]}};
    }
};

template <class N>
N dot(const Triple<N>& a, const Triple<N>& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class N>
N norm2(const Triple<N>& a) {
    return square(a[0]) + square(a[1]) + square(a[2]);
}
template <class N>
Triple<N> cross(const Triple<N>& a, const Triple<N>& b) {
    return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}
template <class N, class V>
Triple<N> triple(const V& v) {
    return {{N(double(v[0])), N(double(v[1])), N(double(v[2]))}};
}

/// The same of three numbers that are exact already.
template <class N>
Triple<N> triple_of(const double (&v)[3]) {
    return {{N(v[0]), N(v[1]), N(v[2])}};
}
template <class N>
const Triple<N>& triple_of(const Triple<N>& v) {
    return v;
}

}  // namespace crofton::exact
