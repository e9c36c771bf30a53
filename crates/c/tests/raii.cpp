// lsdc.hpp: the same bits as the C interface, exceptions, ownership, and views of matrices with the members of cv::Mat.

#include "check.h"
#include <lsdc.hpp>
#include <thread>

namespace {

// The members that lsdc.hpp requires of a matrix.
struct Matrix {
    int rows = 0, cols = 0;
    std::uint8_t *data = nullptr;
    std::size_t step = 0;
    int type = 0, planes = 1;
    int depth() const { return type; }
    int channels() const { return planes; }
};

enum { BYTES = 0, SHORTS = 2, FLOATS = 5, DOUBLES = 6 };

template <class Call>
void throws(lsdc_status status, const char *text, Call call) {
    try {
        call();
    } catch (const lsdc::Error &error) {
        CHECK(error.status() == status);
        CHECK(std::string(error.what()).find(text) != std::string::npos);
        return;
    }
    CHECK(!"nothing was thrown");
}

static_assert(!std::is_copy_constructible_v<lsdc::Completer> && std::is_nothrow_move_constructible_v<lsdc::Completer>);
static_assert(!std::is_copy_constructible_v<lsdc::Scene> && std::is_nothrow_move_constructible_v<lsdc::Scene>);
static_assert(!std::is_copy_constructible_v<lsdc::Completion> && std::is_nothrow_move_assignable_v<lsdc::Completion>);

} // namespace

int main(int count, char **arguments) {
    CHECK(count == 2);
    std::vector<std::uint8_t> rgb(3 * PIXELS), bgr(3 * PIXELS);
    paint(rgb.data(), WIDTH, HEIGHT, 7);
    for (std::size_t i = 0; i < rgb.size(); ++i) bgr[i] = rgb[i / 3 * 3 + 2 - i % 3];
    std::vector<float> sparse(PIXELS);
    std::vector<std::uint16_t> millimetres(PIXELS);
    std::vector<lsdc::Point> points;
    for (std::size_t i = 0; i < PIXELS; i += 17) {
        sparse[i] = i % WIDTH < WIDTH / 2 ? 2.0F : 3.0F;
        millimetres[i] = static_cast<std::uint16_t>(1000.0F * sparse[i]);
        points.push_back({static_cast<double>(i % WIDTH), static_cast<double>(i / WIDTH), sparse[i]});
    }

    lsdc::Options options;
    options.threads = 2;
    options.working_rows = 24;
    options.working_cols = 32;
    lsdc::Completer completer("small", options);
    lsdc::Scene scene = completer.scene({rgb.data(), HEIGHT, WIDTH, lsdc::Format::rgb8});
    completer.release();
    lsdc::Completion completion = scene.complete(points);
    lsdc::Alignment alignment = scene.alignment(points);
    CHECK(scene.alignment(points, &alignment).shift().points == 2 * alignment.shift().points);
    lsdc::Map depth = completion.depth();
    CHECK(depth.rows == HEIGHT && depth.cols == WIDTH && depth.values.size() == PIXELS);

    // The C interface, maps in metres and millimetres, and a matrix of blue, green and red give the same depth.
    std::vector<float> same(PIXELS);
    OK(lsdc_completion_depth(completion.handle(), WIDTH, HEIGHT, same.data(), 4 * PIXELS, 0));
    CHECK(same == depth.values);
    CHECK(scene.complete({{sparse.data(), HEIGHT, WIDTH}}).depth().values == depth.values);
    CHECK(scene.complete({{millimetres.data(), HEIGHT, WIDTH}, 0.001}).depth().values == depth.values);
    Matrix image{HEIGHT, WIDTH, bgr.data(), 3 * WIDTH, BYTES, 3};
    Matrix map{HEIGHT, WIDTH, reinterpret_cast<std::uint8_t *>(sparse.data()), 4 * WIDTH, FLOATS, 1};
    Matrix shorts{HEIGHT, WIDTH, reinterpret_cast<std::uint8_t *>(millimetres.data()), 2 * WIDTH, SHORTS, 1};
    CHECK(completer.scene(image).complete(map).depth().values == depth.values);
    CHECK(scene.complete(lsdc::Depths(shorts, 0.001)).depth().values == depth.values);
    CHECK(scene.complete(map, lsdc::Depths(map)).report().without_deviation == 0);

    // Results written into a part of a matrix.
    std::vector<float> wide(2 * PIXELS, -1.0F);
    Matrix part{HEIGHT, WIDTH, reinterpret_cast<std::uint8_t *>(wide.data()), 8 * WIDTH, FLOATS, 1};
    completion.depth(part);
    CHECK(wide[2 * WIDTH] == depth.at(1, 0) && wide[WIDTH] == -1.0F);
    completion.standard_deviation(part);
    CHECK(wide[2 * WIDTH] == completion.standard_deviation().at(1, 0));
    CHECK(completion.depth(16, 24).values.size() == 16 * 24);

    CHECK(completion.residuals().size() == points.size());
    CHECK(completion.leave_one_out().size() == points.size() && completion.leave_one_out_error() > 0.0);
    CHECK(completion.point_weights().front() == 1.0 && completion.interval(0.95) > 1.9);
    CHECK(std::abs(completion.depth_at(3.0, 0.0) - depth.at(0, 3)) < 1e-3F);
    points[40].depth = 20.0F;
    std::vector<lsdc_outlier> outliers = scene.complete(points).outliers();
    CHECK(!outliers.empty() && outliers.front().index == 40 && outliers.front().depth == 20.0);
    CHECK(scene.complete(points, &completion).report().given == points.size());
    lsdc::Guide guide{lsdc::View<const float>(depth.values.data(), HEIGHT, WIDTH)};
    CHECK(completer.scene(image, guide).complete(map).report().guide_trust >= 0.0);

    lsdc::NetworkInput input = completer.network_input(image);
    CHECK(input.values.size() == 3 * input.rows * input.cols && input.values == completer.network_input(image).values);
    std::vector<float> functions(65 * input.rows * input.cols, 1.0F), pairs(2 * input.rows * input.cols, 1.0F);
    lsdc::NetworkOutput output{functions.data(), pairs.data(), 65, input.rows, input.cols};
    CHECK(completer.scene(image, output).complete(map).report().used == points.size());

    // Errors are exceptions with hints.
    throws(LSDC_ERROR_WEIGHTS, "no weights named `huge`", [] { lsdc::Completer("huge"); });
    throws(LSDC_ERROR_WEIGHTS, arguments[1], [&] { lsdc::Completer::from_file(arguments[1]); });
    throws(LSDC_ERROR_WEIGHTS, "safetensors", [&] { lsdc::Completer::from_memory(rgb.data(), rgb.size()); });
    throws(LSDC_ERROR_FIT, "no sparse depth", [&] { scene.complete(std::vector<lsdc::Point>()); });
    throws(LSDC_ERROR_ARGUMENT, "null", [&] { scene.complete(nullptr, 5); });
    output.functions = 64;
    throws(LSDC_ERROR_FIT, "64 basis functions", [&] { completer.scene(image, output); });
    throws(LSDC_ERROR_BUFFER, "2^30", [&] { completion.depth(SIZE_MAX, 2); });
    throws(LSDC_ERROR_ARGUMENT, "null", [&] { completion.depth(lsdc::View<float>()); });
    throws(LSDC_ERROR_ARGUMENT, "`depth->unit`", [&] { scene.complete(shorts); });
    throws(LSDC_ERROR_BUFFER, "overlap", [&] { scene.complete({{sparse.data(), HEIGHT, WIDTH, 5}}); });
    Matrix wrong = map;
    wrong.type = DOUBLES;
    throws(LSDC_ERROR_ARGUMENT, "another type", [&] { completion.depth(wrong); });
    throws(LSDC_ERROR_ARGUMENT, "another type", [&] { scene.complete(wrong); });
    throws(LSDC_ERROR_ARGUMENT, "is no image", [&] { completer.scene(wrong); });
    wrong.rows = wrong.cols = -1;
    wrong.type = FLOATS;
    throws(LSDC_ERROR_ARGUMENT, "two dimensions", [&] { scene.complete(wrong); });
    throws(LSDC_ERROR_ARGUMENT, "null", [&] { scene.complete(Matrix{HEIGHT, WIDTH, nullptr, 4 * WIDTH, FLOATS, 1}); });
    try {
        (void)depth.at(HEIGHT, 0);
        CHECK(!"nothing was thrown");
    } catch (const std::out_of_range &) {
    }

    // A moved-from object has no handle; the target can be used, also in another thread.
    lsdc::Completion moved = std::move(completion);
    throws(LSDC_ERROR_ARGUMENT, "`completion` is null", [&] { completion.depth(); });
    completion = std::move(moved);
    std::vector<float> elsewhere;
    std::thread([own = std::move(completion), &elsewhere] { elsewhere = own.depth().values; }).join();
    CHECK(elsewhere == depth.values);
    puts("raii: as it should be");
    return EXIT_SUCCESS;
}
