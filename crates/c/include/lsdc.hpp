// lsdc for C++17: handles that free themselves, exceptions, and views of any matrix. A header-only wrapper of
// lsdc.h, which documents units and threads.
//
//     lsdc::Completer completer;
//     auto scene = completer.scene(image);       // cv::Mat, or lsdc::Image(pixels, rows, cols, format)
//     auto completion = scene.complete(points);  // std::vector<lsdc::Point>, or a matrix with depths
//     completion.depth(depth);                   // into a cv::Mat of CV_32F; without it, a lsdc::Map is returned
//
// Handles can be moved, and used from any number of threads at once. All functions except destructors may throw
// lsdc::Error.

#ifndef LSDC_HPP
#define LSDC_HPP

#include "lsdc.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace lsdc {

// A failed call: what() is the message, hint() suggests a remedy.
class Error : public std::runtime_error {
public:
    Error(lsdc_status status, const std::string &message, std::string hint = {})
        : std::runtime_error(message), status_(status), hint_(std::move(hint)) {}

    // One of LSDC_ERROR_...
    lsdc_status status() const noexcept { return status_; }
    // Empty if nothing can be suggested.
    const std::string &hint() const noexcept { return hint_; }

private:
    lsdc_status status_;
    std::string hint_;
};

enum class Format : lsdc_format {
    rgb8 = LSDC_RGB8,
    bgr8 = LSDC_BGR8,
    grey8 = LSDC_GREY8,
    rgba8 = LSDC_RGBA8,
    bgra8 = LSDC_BGRA8,
    rgb_f32 = LSDC_RGB_F32,
    bgr_f32 = LSDC_BGR_F32,
    grey_f32 = LSDC_GREY_F32,
    rgba_f32 = LSDC_RGBA_F32,
    bgra_f32 = LSDC_BGRA_F32,
};

// The model of depth.
enum class Fit : lsdc_fit {
    recommended = LSDC_FIT_DEFAULT,
    lse = LSDC_FIT_LSE,
    field = LSDC_FIT_FIELD,
    joint = LSDC_FIT_JOINT,
};

// How the influence of outliers is limited.
enum class Robust : lsdc_robust {
    recommended = LSDC_ROBUST_DEFAULT,
    none = LSDC_ROBUST_NONE,
    automatic = LSDC_ROBUST_AUTO,
    irls = LSDC_ROBUST_IRLS,
    huber = LSDC_ROBUST_HUBER,
    cauchy = LSDC_ROBUST_CAUCHY,
    gm = LSDC_ROBUST_GM,
    tukey = LSDC_ROBUST_TUKEY,
};

// Quantity of the values of a guide.
enum class GuideKind : lsdc_guide_kind {
    depth = LSDC_GUIDE_DEPTH,
    disparity = LSDC_GUIDE_DISPARITY,
    log = LSDC_GUIDE_LOG,
};

namespace detail {

inline void check(lsdc_status status) {
    if (status != LSDC_OK) throw Error(status, lsdc_last_error(), lsdc_last_hint());
}

// Whether a type is cv::Mat or has the same members.
template <class M, class = void>
struct is_matrix : std::false_type {};
template <class M>
struct is_matrix<M, std::void_t<decltype(std::declval<M &>().rows), decltype(std::declval<M &>().cols),
                                decltype(static_cast<std::size_t>(std::declval<M &>().step)),
                                decltype(std::declval<M &>().data), decltype(std::declval<M &>().depth()),
                                decltype(std::declval<M &>().channels())>> : std::true_type {};
template <class M>
using if_matrix = std::enable_if_t<is_matrix<std::remove_reference_t<M>>::value, int>;

// OpenCV's codes of value types.
constexpr int cv_8u = 0;
constexpr int cv_16u = 2;
constexpr int cv_32f = 5;

template <class T>
constexpr int code() {
    using Value = std::remove_const_t<T>;
    static_assert(std::is_same_v<Value, float> || std::is_same_v<Value, std::uint16_t>,
                  "a view is of float or uint16_t");
    return std::is_same_v<Value, float> ? cv_32f : cv_16u;
}

inline std::size_t side(long long length) {
    if (length < 0) throw Error(LSDC_ERROR_ARGUMENT, "the matrix does not have two dimensions");
    return static_cast<std::size_t>(length);
}

// Bytes from the first value to the last; the library refuses sizes that exceed the memory.
inline std::size_t span(std::size_t rows, std::size_t row, std::size_t stride) {
    return rows == 0 ? 0 : (rows - 1) * (stride == 0 ? row : stride) + row;
}

} // namespace detail

// A view of a matrix in the caller's memory: the first value, rows, columns, and bytes from one row to the next
// (0: no gaps).
template <class T>
struct View {
    T *data = nullptr;
    std::size_t rows = 0;
    std::size_t cols = 0;
    std::size_t stride = 0;

    View() = default;
    View(T *data, std::size_t rows, std::size_t cols, std::size_t stride = 0)
        : data(data), rows(rows), cols(cols), stride(stride) {}

    // A view of a cv::Mat with one channel of this type.
    template <class M, detail::if_matrix<M> = 0>
    View(M &&matrix)
        : data(reinterpret_cast<T *>(matrix.data)), rows(detail::side(matrix.rows)),
          cols(detail::side(matrix.cols)), stride(static_cast<std::size_t>(matrix.step)) {
        if (matrix.channels() != 1 || matrix.depth() != detail::code<T>()) {
            throw Error(LSDC_ERROR_ARGUMENT, "the matrix has another type of values, or more channels",
                        detail::code<T>() == detail::cv_32f ? "give one of CV_32FC1" : "give one of CV_16UC1");
        }
    }

    std::size_t size() const { return detail::span(rows, cols * sizeof(T), stride); }
};

// A view of an image in the caller's memory.
struct Image {
    const void *data = nullptr;
    std::size_t size = 0;
    std::size_t rows = 0;
    std::size_t cols = 0;
    std::size_t stride = 0;
    Format format = Format::rgb8;

    Image(const void *data, std::size_t rows, std::size_t cols, Format format, std::size_t stride = 0)
        : data(data), size(detail::span(rows, cols * bytes(format), stride)), rows(rows), cols(cols), stride(stride),
          format(format) {}

    // A view of a cv::Mat with 1, 3 (blue, green, red) or 4 channels of 8 bits, or of floats from 0 to 1.
    template <class M, detail::if_matrix<M> = 0>
    Image(const M &matrix)
        : Image(matrix.data, detail::side(matrix.rows), detail::side(matrix.cols),
                format_of(matrix.depth(), matrix.channels()), static_cast<std::size_t>(matrix.step)) {}

private:
    static std::size_t bytes(Format format) {
        switch (format) {
        case Format::grey8: return 1;
        case Format::rgb8:
        case Format::bgr8: return 3;
        case Format::rgb_f32:
        case Format::bgr_f32: return 12;
        case Format::rgba_f32:
        case Format::bgra_f32: return 16;
        case Format::rgba8:
        case Format::bgra8:
        case Format::grey_f32: return 4;
        }
        throw Error(LSDC_ERROR_ARGUMENT, "the format of the image is unknown");
    }

    static Format format_of(int depth, int channels) {
        bool floats = depth == detail::cv_32f;
        if (floats || depth == detail::cv_8u) {
            if (channels == 1) return floats ? Format::grey_f32 : Format::grey8;
            if (channels == 3) return floats ? Format::bgr_f32 : Format::bgr8;
            if (channels == 4) return floats ? Format::bgra_f32 : Format::bgra8;
        }
        throw Error(LSDC_ERROR_ARGUMENT, "a matrix of this type is no image",
                    "give one of CV_8U or CV_32F with 1, 3 or 4 channels");
    }
};

// A view of depths in the caller's memory; `unit` is the unit of the values in metres, required for integers.
struct Depths {
    const void *data = nullptr;
    std::size_t size = 0;
    std::size_t rows = 0;
    std::size_t cols = 0;
    std::size_t stride = 0;
    double unit = 1.0;
    lsdc_depth_format format = LSDC_F32;

    Depths(View<const float> view, double unit = 1.0) : Depths(view, unit, LSDC_F32) {}
    Depths(View<const std::uint16_t> view, double unit) : Depths(view, unit, LSDC_U16) {}

    // A view of a cv::Mat of CV_32FC1 or, with a unit such as 0.001, CV_16UC1.
    template <class M, detail::if_matrix<M> = 0>
    Depths(const M &matrix, double unit = 0.0)
        : Depths(matrix.depth() == detail::cv_16u ? Depths(View<const std::uint16_t>(matrix), unit)
                                                  : Depths(View<const float>(matrix), unit == 0.0 ? 1.0 : unit)) {}

    lsdc_map map() const {
        lsdc_map map{};
        map.struct_size = sizeof map;
        map.data = data;
        map.size = size;
        map.width = cols;
        map.height = rows;
        map.stride = stride;
        map.unit = unit;
        map.format = format;
        return map;
    }

private:
    template <class T>
    Depths(View<T> view, double unit, lsdc_depth_format format)
        : data(view.data), size(view.size()), rows(view.rows), cols(view.cols), stride(view.stride), unit(unit),
          format(format) {}
};

// A known depth at column x and row y, which may lie between pixels. A sigma that is not positive and finite means unknown.
struct Point {
    double x = 0.0;
    double y = 0.0;
    float depth = 0.0F;
    float sigma = 0.0F;
};

// A matrix of floats that owns its memory.
struct Map {
    std::size_t rows = 0;
    std::size_t cols = 0;
    std::vector<float> values;

    float at(std::size_t row, std::size_t col) const {
        if (row >= rows || col >= cols) throw std::out_of_range("lsdc::Map::at");
        return values[row * cols + col];
    }
    View<const float> view() const { return {values.data(), rows, cols}; }
};

// Settings of a completer; see lsdc_completer_options.
struct Options {
    std::size_t threads = 0;
    std::size_t working_rows = 0;
    std::size_t working_cols = 0;
    Fit fit = Fit::recommended;
    Robust robust = Robust::recommended;
    std::size_t encoder_side = 0;
};

// A dense depth prediction from another source, up to scale and shift.
struct Guide {
    Depths values;
    GuideKind kind = GuideKind::depth;
};

// Maps of red, green and blue from 0 to 1: the input of the graph of `lsdc weights export`.
struct NetworkInput {
    std::size_t rows = 0;
    std::size_t cols = 0;
    std::vector<float> values;
};

// A view of the graph's output in the caller's memory: `functions` maps of basis functions and two of affinities.
struct NetworkOutput {
    const float *basis = nullptr;
    const float *affinities = nullptr;
    std::size_t functions = 0;
    std::size_t rows = 0;
    std::size_t cols = 0;
};

// A scene fitted to points.
class Completion {
public:
    // The size of the image.
    std::size_t rows() const noexcept { return rows_; }
    std::size_t cols() const noexcept { return cols_; }

    // The dense depth in the unit of the points, at the size of the image, at another size, or written into a
    // matrix of any size.
    Map depth() const { return depth(rows_, cols_); }
    Map depth(std::size_t rows, std::size_t cols) const { return map(lsdc_completion_depth, rows, cols); }
    void depth(View<float> into) const { write(lsdc_completion_depth, into); }

    // The standard deviation of the depth errors.
    Map standard_deviation() const { return standard_deviation(rows_, cols_); }
    Map standard_deviation(std::size_t rows, std::size_t cols) const {
        return map(lsdc_completion_standard_deviation, rows, cols);
    }
    void standard_deviation(View<float> into) const { write(lsdc_completion_standard_deviation, into); }

    // The depth at a position of the image.
    float depth_at(double x, double y) const {
        float depth = 0.0F;
        detail::check(lsdc_completion_depth_at(handle(), &x, &y, &depth, 1));
        return depth;
    }

    // The number of standard deviations that contain a share of the errors.
    double interval(double level) const {
        double deviations = 0.0;
        detail::check(lsdc_completion_interval(handle(), level, &deviations));
        return deviations;
    }

    lsdc_report report() const {
        lsdc_report report{};
        report.struct_size = sizeof report;
        detail::check(lsdc_completion_report(handle(), &report));
        return report;
    }

    // One value for each point given; NaN if the point was not used.
    std::vector<double> residuals() const { return points(lsdc_completion_residuals); }
    std::vector<double> leave_one_out() const { return points(lsdc_completion_leave_one_out); }
    std::vector<double> point_weights() const { return points(lsdc_completion_point_weights); }

    // An estimate of the depth error between the points; NaN if it is unknown.
    double leave_one_out_error() const {
        double error = 0.0;
        detail::check(lsdc_completion_leave_one_out_error(handle(), &error));
        return error;
    }

    // The points that are more likely outliers than inliers, worst first.
    std::vector<lsdc_outlier> outliers() const {
        std::vector<lsdc_outlier> found(report().used);
        std::size_t count = 0;
        detail::check(
            lsdc_completion_outliers(handle(), found.data(), found.size(), sizeof(lsdc_outlier), &count));
        found.resize(count);
        return found;
    }

    lsdc_completion *handle() const noexcept { return handle_.get(); }

private:
    friend class Scene;
    struct Free {
        void operator()(lsdc_completion *completion) const noexcept { lsdc_completion_free(completion); }
    };
    using Write = lsdc_status (*)(const lsdc_completion *, std::size_t, std::size_t, float *, std::size_t,
                                  std::size_t);
    using Each = lsdc_status (*)(const lsdc_completion *, double *, std::size_t);

    Completion(lsdc_completion *handle, std::size_t rows, std::size_t cols)
        : handle_(handle), rows_(rows), cols_(cols) {}

    void write(Write what, View<float> into) const {
        detail::check(what(handle(), into.cols, into.rows, into.data, into.size(), into.stride));
    }

    Map map(Write what, std::size_t rows, std::size_t cols) const {
        if (rows != 0 && cols > (std::size_t{1} << 30) / rows) {
            throw Error(LSDC_ERROR_BUFFER, "a map has at most 2^30 pixels");
        }
        Map map{rows, cols, std::vector<float>(rows * cols)};
        write(what, {map.values.data(), rows, cols});
        return map;
    }

    std::vector<double> points(Each what) const {
        std::vector<double> values(report().given);
        detail::check(what(handle(), values.data(), values.size()));
        return values;
    }

    std::unique_ptr<lsdc_completion, Free> handle_;
    std::size_t rows_;
    std::size_t cols_;
};

// Evidence from frames of a shift between points and images, caused by wrong extrinsics or time stamps.
class Alignment {
public:
    // The best shift, whether it is clear or not.
    lsdc_shift shift() const {
        lsdc_shift shift{};
        shift.struct_size = sizeof shift;
        detail::check(lsdc_alignment_shift(handle(), &shift));
        return shift;
    }

    lsdc_alignment *handle() const noexcept { return handle_.get(); }

private:
    friend class Scene;
    struct Free {
        void operator()(lsdc_alignment *alignment) const noexcept { lsdc_alignment_free(alignment); }
    };

    explicit Alignment(lsdc_alignment *handle) : handle_(handle) {}

    std::unique_ptr<lsdc_alignment, Free> handle_;
};

// The output of the network for an image, ready to be fitted to points.
class Scene {
public:
    std::size_t rows() const noexcept { return rows_; }
    std::size_t cols() const noexcept { return cols_; }

    // Fits the scene to points. `previous` is the completion of the previous frame of a video.
    Completion complete(const Point *points, std::size_t count, const Completion *previous = nullptr) const {
        lsdc_points all = columns(points, count);
        lsdc_complete_options options = settings(previous);
        lsdc_completion *completion = nullptr;
        detail::check(lsdc_scene_complete(handle(), &all, &options, &completion));
        return {completion, rows_, cols_};
    }
    Completion complete(const std::vector<Point> &points, const Completion *previous = nullptr) const {
        return complete(points.data(), points.size(), previous);
    }

    // Fits the scene to a map of the size of the image, with 0 at pixels without a measurement.
    Completion complete(const Depths &depths, const Completion *previous = nullptr) const {
        return complete(depths.map(), nullptr, previous);
    }
    // Resolves an ambiguity: cv::Mat also converts to a vector of points.
    template <class M, detail::if_matrix<M> = 0>
    Completion complete(const M &depths, const Completion *previous = nullptr) const {
        return complete(Depths(depths), previous);
    }
    Completion complete(const Depths &depths, const Depths &sigmas, const Completion *previous = nullptr) const {
        lsdc_map sigma = sigmas.map();
        return complete(depths.map(), &sigma, previous);
    }

    // Tests whether points are aligned with the image. One image is rarely enough: `before` is the evidence of
    // earlier frames, which the result includes.
    Alignment alignment(const std::vector<Point> &points, const Alignment *before = nullptr) const {
        lsdc_points all = columns(points.data(), points.size());
        lsdc_alignment *alignment = nullptr;
        detail::check(
            lsdc_scene_alignment(handle(), &all, before == nullptr ? nullptr : before->handle(), &alignment));
        return Alignment(alignment);
    }

    lsdc_scene *handle() const noexcept { return handle_.get(); }

private:
    friend class Completer;
    struct Free {
        void operator()(lsdc_scene *scene) const noexcept { lsdc_scene_free(scene); }
    };

    Scene(lsdc_scene *handle, std::size_t rows, std::size_t cols) : handle_(handle), rows_(rows), cols_(cols) {}

    static lsdc_points columns(const Point *points, std::size_t count) {
        static const Point none;
        const Point *first = points == nullptr && count == 0 ? &none : points;
        lsdc_points all{};
        all.struct_size = sizeof all;
        all.count = count;
        all.stride = sizeof(Point);
        if (first != nullptr) {
            all.x = &first->x;
            all.y = &first->y;
            all.depth = &first->depth;
            all.sigma = &first->sigma;
        }
        return all;
    }

    static lsdc_complete_options settings(const Completion *previous) {
        lsdc_complete_options options{};
        options.struct_size = sizeof options;
        options.previous = previous == nullptr ? nullptr : previous->handle();
        return options;
    }

    Completion complete(const lsdc_map &depth, const lsdc_map *sigma, const Completion *previous) const {
        lsdc_complete_options options = settings(previous);
        lsdc_completion *completion = nullptr;
        detail::check(lsdc_scene_complete_map(handle(), &depth, sigma, &options, &completion));
        return {completion, rows_, cols_};
    }

    std::unique_ptr<lsdc_scene, Free> handle_;
    std::size_t rows_;
    std::size_t cols_;
};

// A trained network, the settings of the fit, and threads.
class Completer {
public:
    // Uses weights of the library: see lsdc_completer_create.
    explicit Completer(const std::string &weights = "default", const Options &options = {})
        : Completer(options, [&](const lsdc_completer_options *settings, lsdc_completer **completer) {
              return lsdc_completer_create(weights.c_str(), settings, completer);
          }) {}

    // Uses weights from a file, as `lsdc train` writes them.
    static Completer from_file(const std::string &path, const Options &options = {}) {
        return {options, [&](const lsdc_completer_options *settings, lsdc_completer **completer) {
                    return lsdc_completer_create_from_file(path.c_str(), settings, completer);
                }};
    }

    // Uses weights from the bytes of such a file, which are not needed afterwards.
    static Completer from_memory(const void *data, std::size_t size, const Options &options = {}) {
        return {options, [&](const lsdc_completer_options *settings, lsdc_completer **completer) {
                    return lsdc_completer_create_from_memory(data, size, settings, completer);
                }};
    }

    // Runs the network on an image, which is not needed afterwards.
    Scene scene(const Image &image) const { return scene(image, lsdc_scene_options{}); }

    // The same without a guide, not even from the depth head of "anything".
    Scene unguided_scene(const Image &image) const {
        lsdc_scene_options options{};
        options.guide_kind = LSDC_GUIDE_NONE;
        return scene(image, options);
    }

    // The same with a dense depth prediction of any size.
    Scene scene(const Image &image, const Guide &guide) const {
        lsdc_map map = guide.values.map();
        lsdc_scene_options options{};
        options.guide = &map;
        options.guide_kind = static_cast<lsdc_guide_kind>(guide.kind);
        return scene(image, options);
    }

    // Frees memory that is kept for further images and fits; later calls allocate again.
    void release() const { detail::check(lsdc_completer_release(handle())); }

    // The input for a network that another program runs.
    NetworkInput network_input(const Image &image) const {
        NetworkInput found;
        detail::check(lsdc_completer_network_size(handle(), image.cols, image.rows, &found.cols, &found.rows));
        found.values.resize(3 * found.rows * found.cols);
        lsdc_image input = input_of(image);
        detail::check(lsdc_completer_network_input(handle(), &input, found.values.data(),
                                                   found.values.size() * sizeof(float)));
        return found;
    }

    // A scene from the output of such a network, which is not needed afterwards.
    Scene scene(const Image &image, const NetworkOutput &output) const {
        lsdc_network_output computed{};
        computed.struct_size = sizeof computed;
        computed.basis = output.basis;
        computed.affinities = output.affinities;
        computed.functions = output.functions;
        computed.width = output.cols;
        computed.height = output.rows;
        lsdc_scene_options options{};
        options.output = &computed;
        return scene(image, options);
    }

    lsdc_completer *handle() const noexcept { return handle_.get(); }

private:
    struct Free {
        void operator()(lsdc_completer *completer) const noexcept { lsdc_completer_free(completer); }
    };

    template <class Create>
    Completer(const Options &options, Create create) {
        if (lsdc_abi_version() != LSDC_ABI_VERSION) {
            throw Error(LSDC_ERROR_ARGUMENT, "the library has another interface than lsdc.h",
                        "compile the program with the header that was installed with the library");
        }
        lsdc_completer_options settings{};
        settings.struct_size = sizeof settings;
        settings.threads = options.threads;
        settings.working_width = options.working_cols;
        settings.working_height = options.working_rows;
        settings.fit = static_cast<lsdc_fit>(options.fit);
        settings.robust = static_cast<lsdc_robust>(options.robust);
        settings.encoder_side = options.encoder_side;
        lsdc_completer *completer = nullptr;
        detail::check(create(&settings, &completer));
        handle_.reset(completer);
    }

    static lsdc_image input_of(const Image &image) {
        lsdc_image input{};
        input.struct_size = sizeof input;
        input.data = image.data;
        input.size = image.size;
        input.width = image.cols;
        input.height = image.rows;
        input.stride = image.stride;
        input.format = static_cast<lsdc_format>(image.format);
        return input;
    }

    Scene scene(const Image &image, lsdc_scene_options options) const {
        options.struct_size = sizeof options;
        lsdc_image input = input_of(image);
        lsdc_scene *scene = nullptr;
        detail::check(lsdc_scene_create(handle(), &input, &options, &scene));
        return {scene, image.rows, image.cols};
    }

    std::unique_ptr<lsdc_completer, Free> handle_;
};

} // namespace lsdc

#endif
