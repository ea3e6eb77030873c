#include "client/cpu/cell_walk.h"

namespace brickyard {

double integratePositiveCubic(double v0, double v1, double v2, double v3) {
    // Newton's form through the four equidistant values, as a + b s + c s^2 + d s^3.
    const double a = v0;
    const double b = (-11 * v0 + 18 * v1 - 9 * v2 + 2 * v3) / 2;
    const double c = 9 * (2 * v0 - 5 * v1 + 4 * v2 - v3) / 2;
    const double d = 9 * (-v0 + 3 * v1 - 3 * v2 + v3) / 2;
    auto value = [&](double s) { return a + s * (b + s * (c + s * d)); };
    auto integral = [&](double s) { return s * (a + s * (b / 2 + s * (c / 3 + s * d / 4))); };

    // Between the extrema the cubic is monotone: at most one root in each piece, found by bisection.
    double knots[4] = {0, 1, 1, 1};
    int count = 1;
    const double discriminant = c * c - 3 * b * d;
    if (discriminant > 0) {
        // The stable form: no cancellation where d vanishes.
        const double q = -(c + std::copysign(std::sqrt(discriminant), c));
        double extrema[2] = {d != 0 ? q / (3 * d) : -1, q != 0 ? b / q : -1};
        if (extrema[0] > extrema[1]) std::swap(extrema[0], extrema[1]);
        for (double s : extrema)
            if (s > 0 && s < 1) knots[count++] = s;
    } else if (d == 0 && c != 0) {
        const double s = -b / (2 * c);
        if (s > 0 && s < 1) knots[count++] = s;
    }
    knots[count++] = 1;

    double sum = 0;
    for (int i = 0; i + 1 < count; ++i) {
        double from = knots[i], to = knots[i + 1];
        const bool begins_positive = value(from) > 0, ends_positive = value(to) > 0;
        if (begins_positive != ends_positive) {
            double low = from, high = to;
            for (int k = 0; k < 60 && low < high; ++k) {
                const double middle = 0.5 * (low + high);
                if ((value(middle) > 0) == begins_positive)
                    low = middle;
                else
                    high = middle;
            }
            if (begins_positive)
                to = low;
            else
                from = high;
        } else if (!begins_positive) {
            continue;
        }
        sum += integral(to) - integral(from);
    }
    return std::max(0.0, sum);
}

}  // namespace brickyard
