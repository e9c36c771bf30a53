// lsdc: an RGB image and a few sparse depths in, a dense depth map out.
//
// An lsdc_completer turns an image into an lsdc_scene, which runs the network, once; a scene turns points
// into an lsdc_completion, which runs a fit, as often as you like. Depth, standard deviations, residuals
// and outliers are asked from the completion.
//
// Units. Depths are along the optical axis in metres, or in any other unit, which is then that of all
// results. Positions are in pixels: x to the right, y down, (0, 0) is the centre of the first pixel.
// Strides and sizes of buffers are in bytes.
//
// Errors. A function returns LSDC_OK or one of LSDC_ERROR_...; lsdc_last_error() and lsdc_last_hint() tell
// this thread what was wrong and what to do. A call that fails changes nothing but the handle that it would
// have returned, or the count of outliers, which become null and 0.
//
// Ownership. What the caller passes is copied, so that it may be freed or changed as soon as the call
// returns. Handles belong to the caller, who frees each once, in any order; they are numbers, not
// addresses. Null, freed and foreign handles give an error. That a buffer is as long as its size says
// cannot be checked.
//
// Threads. Every function may be called from any number of threads at once, on the same handle too: handles
// do not change. The same input gives the same bits for any number of threads. After fork(), a child makes
// a completer of its own: work with those of its parent gives LSDC_ERROR_HANDLE.
//
// Structures begin with their size, so that fields can be added at their end: a program that was compiled
// with an older header keeps working. Set struct_size, leave the other fields that you do not need 0:
//
//     lsdc_image image = {.struct_size = sizeof image, .data = pixels, .size = 3 * 640 * 480,
//                         .width = 640, .height = 480, .format = LSDC_RGB8};
//
// Written by cbindgen from the sources of lsdc-c. Do not edit.


#ifndef LSDC_H
#define LSDC_H

#include <stddef.h>
#include <stdint.h>

/// The version of this interface, which is part of the name of the shared library (`liblsdc.so.1`). It rises
/// when a program that was compiled with an older header would no longer work.
#define LSDC_ABI_VERSION 1

/// The evidence of one or more frames for a shift between points and images, as wrong extrinsics or time stamps cause.
typedef struct lsdc_alignment lsdc_alignment;

/// A trained network with the settings of the fit, and threads.
typedef struct lsdc_completer lsdc_completer;

/// A scene fitted to points. What is not part of the fit is computed on request.
typedef struct lsdc_completion lsdc_completion;

/// Everything that depends on an image alone: the network ran once, each set of points costs a fit.
typedef struct lsdc_scene lsdc_scene;

/// What became of a call: `LSDC_OK`, or one of the codes `LSDC_ERROR_...`.
typedef int32_t lsdc_status;

/// The model of depth: one of the constants `LSDC_FIT_...`.
typedef uint32_t lsdc_fit;

/// How the influence of wrong points is limited: one of the constants `LSDC_ROBUST_...`.
typedef uint32_t lsdc_robust;

/// Settings of a completer; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_completer_options)`.
typedef struct lsdc_completer_options {
    /// `sizeof(lsdc_completer_options)`.
    size_t struct_size;
    /// Threads of its own, at most 4096. 0 means those that all such completers share, one per core.
    size_t threads;
    /// With `working_height`: images are resized to about as many pixels as this size has, with their aspect
    /// ratio kept, before they enter the network. Both 0 means the size of the training images.
    size_t working_width;
    /// See `working_width`.
    size_t working_height;
    /// The model of depth.
    lsdc_fit fit;
    /// How the influence of wrong points is limited.
    lsdc_robust robust;
} lsdc_completer_options;

/// The order and type of the colours of a pixel: one of the constants `LSDC_...8` and `LSDC_...F32`.
typedef uint32_t lsdc_format;

/// An image in the caller's memory. Set `struct_size` to `sizeof(lsdc_image)`.
typedef struct lsdc_image {
    /// `sizeof(lsdc_image)`.
    size_t struct_size;
    /// The first pixel of the first row. No alignment is needed.
    const void *data;
    /// Bytes of the buffer from there: up to the last pixel, or the end of the last row's stride.
    size_t size;
    /// Number of columns.
    size_t width;
    /// Number of rows; width times height is at most 2^30.
    size_t height;
    /// Bytes from the start of one row to the next; 0 means without gaps.
    size_t stride;
    /// One of the constants `LSDC_RGB8` to `LSDC_BGRA_F32`.
    lsdc_format format;
    /// 0.
    uint32_t reserved;
} lsdc_image;

/// The type of the values of a map: `LSDC_F32` or `LSDC_U16`.
typedef uint32_t lsdc_depth_format;

/// A map of depths, of their standard deviations, or of a guide in the caller's memory. Set `struct_size` to
/// `sizeof(lsdc_map)`.
typedef struct lsdc_map {
    /// `sizeof(lsdc_map)`.
    size_t struct_size;
    /// The first value of the first row. No alignment is needed.
    const void *data;
    /// Bytes of the buffer from there: up to the last value, or the end of the last row's stride.
    size_t size;
    /// Number of columns.
    size_t width;
    /// Number of rows; width times height is at most 2^30.
    size_t height;
    /// Bytes from the start of one row to the next; 0 means without gaps.
    size_t stride;
    /// What a value of 1 stands for, in metres: 0.001 for millimetres. 0 means 1 for floats; integers need
    /// it.
    double unit;
    /// `LSDC_F32` or `LSDC_U16`.
    lsdc_depth_format format;
    /// 0.
    uint32_t reserved;
} lsdc_map;

/// What the values of a guide mean, each up to scale and shift: one of the constants `LSDC_GUIDE_...`.
typedef uint32_t lsdc_guide_kind;

/// Basis functions and affinities of an image that another program computed, such as ONNX Runtime with the graph of `lsdc
/// weights export`. Set `struct_size` to `sizeof(lsdc_network_output)`.
typedef struct lsdc_network_output {
    /// `sizeof(lsdc_network_output)`.
    size_t struct_size;
    /// `functions` maps of `height` rows of `width` values, without gaps: the output `basis` of the graph.
    const float *basis;
    /// Two such maps, of each pixel with its right and its lower neighbour: the output `affinities`. Not negative.
    const float *affinities;
    /// Number of basis functions: that of the weights of the completer.
    size_t functions;
    /// Number of columns.
    size_t width;
    /// Number of rows.
    size_t height;
} lsdc_network_output;

/// Settings of a scene; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_scene_options)`.
typedef struct lsdc_scene_options {
    /// `sizeof(lsdc_scene_options)`.
    size_t struct_size;
    /// A dense prediction of the depth of the image by other means, of any size, or null. Unit, scale and
    /// shift need not be known; NaN marks gaps. Null is that of the depth head of "anything" if it is installed.
    const struct lsdc_map *guide;
    /// What its values mean.
    lsdc_guide_kind guide_kind;
    /// 0.
    uint32_t reserved;
    /// The output of the network on this image, computed by another program, or null: the network is run. Any size is
    /// possible, at which a fit with a field is solved. Points between its pixels read functions that are interpolated.
    const struct lsdc_network_output *output;
} lsdc_scene_options;

/// Known depths at some positions of an image, in the caller's memory. Set `struct_size` to
/// `sizeof(lsdc_points)`.
///
/// With a stride of 0, `x`, `y`, `depth` and `sigma` are arrays of `count` values; otherwise they lead to the
/// fields of the first of `count` structures that are `stride` bytes apart.
typedef struct lsdc_points {
    /// `sizeof(lsdc_points)`.
    size_t struct_size;
    /// Number of points, at most 2^30.
    size_t count;
    /// Columns, which may lie between pixels: 0 is the centre of the first, and the image ends at `width -
    /// 0.5`.
    const double *x;
    /// Rows, downwards: 0 is the centre of the first, and the image ends at `height - 0.5`.
    const double *y;
    /// Depths along the optical axis in metres, or in any other unit, which is then that of all results.
    const float *depth;
    /// Standard deviations of the depths in the same unit; null if all are unknown. One that is not positive and finite
    /// (0, negative, NaN, infinite) is unknown, and counted in `lsdc_report.without_deviation` if others are known.
    const float *sigma;
    /// Bytes from one point to the next in all of the arrays; 0 means without gaps.
    size_t stride;
} lsdc_points;

/// Settings of a completion; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_complete_options)`.
typedef struct lsdc_complete_options {
    /// `sizeof(lsdc_complete_options)`.
    size_t struct_size;
    /// The completion of the previous frame of a video, towards which this one is drawn, or null. Both need
    /// completers with the same weights and fit.
    const struct lsdc_completion *previous;
} lsdc_complete_options;

/// Statistics of a fit. Set `struct_size` to `sizeof(lsdc_report)`.
typedef struct lsdc_report {
    /// `sizeof(lsdc_report)`.
    size_t struct_size;
    /// Points that were given: `used + invalid + outside`.
    size_t given;
    /// Points that were fitted.
    size_t used;
    /// Points left out because their depth is not from 1e-15 to 1e15, or their position not finite.
    size_t invalid;
    /// Points left out because they are outside the image.
    size_t outside;
    /// Points used without a sigma, or with one that is not positive and finite, where others had one.
    size_t without_deviation;
    /// Directions that the points determine, at most `functions`.
    size_t rank;
    /// Basis functions of the network, including the constant.
    size_t functions;
    /// Root mean square of the residuals, in the unit of the points.
    double residual;
    /// The strength of the prior; NaN if there is none.
    double lambda;
    /// How far the guide was trusted, 0 if the points do not support it; NaN if there was none.
    double guide_trust;
    /// Depths are clamped to be at least this, a tenth of the smallest given depth.
    double lowest;
    /// Depths are clamped to be at most this, ten times the largest given depth.
    double highest;
    /// Run time of the network in seconds.
    double network_seconds;
    /// Run time of the fit in seconds, including `field_seconds` and `solve_seconds`.
    double fit_seconds;
    /// Run time of what only the first fit to an image does, in seconds.
    double field_seconds;
    /// Run time of the solver in seconds.
    double solve_seconds;
    /// The model of depth: `LSDC_FIT_LSE`, `LSDC_FIT_FIELD` or `LSDC_FIT_JOINT`.
    lsdc_fit fit;
    /// 0.
    uint32_t reserved;
    /// How far the map goes from the joint fit, 0, to the median of this fit, of the field alone, and of the surface that
    /// the points span, 1; NaN for other fits, and for points that span no surface.
    double median_share;
} lsdc_report;

/// A point that is more likely wrong than right, judged by the others.
typedef struct lsdc_outlier {
    /// Its index among the given points, from 0.
    size_t index;
    /// Its column.
    double x;
    /// Its row.
    double y;
    /// Its depth.
    double depth;
    /// The probability that it is wrong, from 0.5 to 1.
    double probability;
    /// Its distance from what the others predict, in the scale of the errors of right points there; positive
    /// if it is farther away.
    double score;
    /// Its depth minus what the others predict.
    double error;
    /// The weight that it kept in a robust fit.
    double weight;
} lsdc_outlier;

/// The shift of the points at which they fit the images best. Set `struct_size` to `sizeof(lsdc_shift)`.
typedef struct lsdc_shift {
    /// `sizeof(lsdc_shift)`.
    size_t struct_size;
    /// To the right, in pixels of the image; NaN without evidence.
    double x;
    /// Down, in pixels of the image; NaN without evidence.
    double y;
    /// Mean leave-one-out error of the points where they are, over their depth; NaN without evidence.
    double error;
    /// The same of the moved points.
    double error_moved;
    /// The gain in log-likelihood over its standard error; 0 without evidence.
    double standard_errors;
    /// Points that were compared, over all frames.
    size_t points;
    /// Frames with evidence.
    size_t frames;
    /// 1 if chance does not explain the shift: it is 6 standard errors in five frames or more, 9 in fewer, and lowers the
    /// error by 5 %. Check extrinsics and time stamps then. Otherwise 0.
    uint32_t is_clear;
    /// 0.
    uint32_t reserved;
} lsdc_shift;

/// The call did what it was asked for.
#define LSDC_OK 0

/// A pointer is null, a structure has an impossible `struct_size`, or a constant is unknown.
#define LSDC_ERROR_ARGUMENT 1

/// A handle was freed before, is none of this library's, or was made before `fork()`.
#define LSDC_ERROR_HANDLE 2

/// The size, the stride or the number of pixels of a buffer is not that of its contents.
#define LSDC_ERROR_BUFFER 3

/// The colours of an image, or the values of a guide, cannot be used.
#define LSDC_ERROR_IMAGE 4

/// Weights cannot be read, or do not match their network.
#define LSDC_ERROR_WEIGHTS 5

/// A setting is out of range.
#define LSDC_ERROR_SETTINGS 6

/// The fit has no solution: too few points, or none that can be used.
#define LSDC_ERROR_FIT 7

/// Memory for a copy of the caller's data cannot be had.
#define LSDC_ERROR_MEMORY 8

/// An error in lsdc itself, which should be reported.
#define LSDC_ERROR_INTERNAL 9

/// Red, green, blue, 8 bits each.
#define LSDC_RGB8 0

/// Blue, green, red, 8 bits each, as OpenCV reads images.
#define LSDC_BGR8 1

/// One grey value of 8 bits.
#define LSDC_GREY8 2

/// Red, green, blue and a byte that is ignored.
#define LSDC_RGBA8 3

/// Blue, green, red and a byte that is ignored.
#define LSDC_BGRA8 4

/// As `LSDC_RGB8` in floats from 0 (black) to 1 (white); a little outside is clamped, above 16 an error.
#define LSDC_RGB_F32 16

/// As `LSDC_BGR8` in floats.
#define LSDC_BGR_F32 17

/// As `LSDC_GREY8` in floats.
#define LSDC_GREY_F32 18

/// As `LSDC_RGBA8` in floats.
#define LSDC_RGBA_F32 19

/// As `LSDC_BGRA8` in floats.
#define LSDC_BGRA_F32 20

/// 32-bit floats.
#define LSDC_F32 0

/// 16-bit integers without sign, in the byte order of the machine.
#define LSDC_U16 1

/// Depths above 0.
#define LSDC_GUIDE_DEPTH 0

/// Inverse depths, larger is nearer, as MiDaS and Depth Anything predict.
#define LSDC_GUIDE_DISPARITY 1

/// Logarithms of depths.
#define LSDC_GUIDE_LOG 2

/// With a guide of null: no guide, not even that of the depth head of "anything".
#define LSDC_GUIDE_NONE 3

/// That for which the weights were trained.
#define LSDC_FIT_DEFAULT 0

/// Basis functions alone: least squares as in the paper.
#define LSDC_FIT_LSE 1

/// A field alone, which is smooth except across edges.
#define LSDC_FIT_FIELD 2

/// Basis functions and a field.
#define LSDC_FIT_JOINT 3

/// As the weights say; those of the library do not limit it.
#define LSDC_ROBUST_DEFAULT 0

/// Not at all.
#define LSDC_ROBUST_NONE 1

/// By the probability of each point to be right, judged by the others.
#define LSDC_ROBUST_AUTO 2

/// Least absolute residuals, as in the paper.
#define LSDC_ROBUST_IRLS 3

/// Huber's loss.
#define LSDC_ROBUST_HUBER 4

/// Cauchy's loss.
#define LSDC_ROBUST_CAUCHY 5

/// The loss of Geman and McClure.
#define LSDC_ROBUST_GM 6

/// Tukey's biweight.
#define LSDC_ROBUST_TUKEY 7

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/// What was wrong in the last call on this thread that failed: one sentence in UTF-8, or "" if none failed
/// yet. Calls that succeed leave it as it is. The text belongs to the library and lives until the next
/// failing call on this thread, or its end.
const char *lsdc_last_error(void);

/// What to do about the error of `lsdc_last_error`, or "" if nothing can be suggested. It lives as long.
const char *lsdc_last_hint(void);

/// The version of the library, as "0.2.0". The text lives as long as the program.
const char *lsdc_version(void);

/// The version of the interface of the library that was loaded. A program can compare it with
/// `LSDC_ABI_VERSION`, that of the header which it was compiled with.
uint32_t lsdc_abi_version(void);

/// Makes a completer with weights of the library: "default", the most accurate that need nothing installed, "small",
/// which take two thirds of the time, "anything", the most accurate of all, or "none", no network at all, for scenes
/// with a guide. "anything" needs an encoder that the program `lsdc` installs once in the user's data folder: `lsdc
/// weights get anything`, or `lsdc weights add FILE` without a network; LSDC_WEIGHTS names another folder. `options`
/// may be null. `*completer` becomes a handle to be freed with `lsdc_completer_free`, or null if the call fails.
lsdc_status lsdc_completer_create(const char *weights,
                                  const struct lsdc_completer_options *options,
                                  struct lsdc_completer **completer);

/// Makes a completer with weights from a file, as `lsdc train` writes them. `path` ends with a zero; it is
/// UTF-8 on Windows. Otherwise as `lsdc_completer_create`.
lsdc_status lsdc_completer_create_from_file(const char *path,
                                            const struct lsdc_completer_options *options,
                                            struct lsdc_completer **completer);

/// Makes a completer with weights from the `size` bytes of such a file in memory, which are not needed
/// afterwards. Otherwise as `lsdc_completer_create`.
lsdc_status lsdc_completer_create_from_memory(const void *data,
                                              size_t size,
                                              const struct lsdc_completer_options *options,
                                              struct lsdc_completer **completer);

/// Frees the memory that a completer keeps for further images and fits, of which the latter is shared by all completers, and
/// with glibc hands all free memory of the process back to the system. A program that has little memory calls it after
/// `lsdc_scene_create`; later calls allocate again.
lsdc_status lsdc_completer_release(const struct lsdc_completer *completer);

/// Of glibc, whose allocator keeps freed memory for the thread that had it.
extern int malloc_trim(size_t kept);

/// Frees a completer; null is ignored. Its scenes, and calls that use it at this moment, are not affected. A
/// handle that was freed before is an error, `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_completer_free(struct lsdc_completer *completer);

/// Writes the size of the network's input for an image of `image_width` columns and `image_height` rows.
lsdc_status lsdc_completer_network_size(const struct lsdc_completer *completer,
                                        size_t image_width,
                                        size_t image_height,
                                        size_t *width,
                                        size_t *height);

/// Writes an image as the graph of `lsdc weights export` reads it: maps of red, green and blue from 0 to 1, without gaps,
/// each of the size that `lsdc_completer_network_size` writes. `size` is the number of bytes from `values` to the end of the
/// buffer. If the call fails, the buffer is unchanged.
lsdc_status lsdc_completer_network_input(const struct lsdc_completer *completer,
                                         const struct lsdc_image *image,
                                         float *values,
                                         size_t size);

/// Runs the network on an image. The buffer is not needed afterwards. `options` may be null. `*scene` becomes
/// a handle to be freed with `lsdc_scene_free`, or null if the call fails.
lsdc_status lsdc_scene_create(const struct lsdc_completer *completer,
                              const struct lsdc_image *image,
                              const struct lsdc_scene_options *options,
                              struct lsdc_scene **scene);

/// The size of the image of a scene.
lsdc_status lsdc_scene_size(const struct lsdc_scene *scene, size_t *width, size_t *height);

/// Fits the scene to points. They are not needed afterwards. Points outside the image, and those whose depth
/// is not from 1e-15 to 1e15, are left out and counted in the report. `options` may be null.
/// `*completion` becomes a handle to be freed with `lsdc_completion_free`, or null if the call fails.
lsdc_status lsdc_scene_complete(const struct lsdc_scene *scene,
                                const struct lsdc_points *points,
                                const struct lsdc_complete_options *options,
                                struct lsdc_completion **completion);

/// Fits the scene to a map of the size of its image, where 0 means no measurement. NaN, infinite and negative
/// values, and marks of no measurement (65535 of 16 bits, if no other value is near it), are left out and counted in the
/// report, as invalid. The points are the pixels that are not 0, row
/// by row. `sigma` is a map of the standard deviations of the depths, not positive and finite where
/// they are unknown (0, NaN), or null.
/// Otherwise as `lsdc_scene_complete`.
lsdc_status lsdc_scene_complete_map(const struct lsdc_scene *scene,
                                    const struct lsdc_map *depth,
                                    const struct lsdc_map *sigma,
                                    const struct lsdc_complete_options *options,
                                    struct lsdc_completion **completion);

/// Frees a scene; null is ignored. Its completions, and calls that use it at this moment, are not affected. A
/// handle that was freed before is an error, `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_scene_free(struct lsdc_scene *scene);

/// Writes the dense depth, in the unit of the points, as `height` rows of `width` floats, whose rows start
/// `stride` bytes apart (without gaps if that is 0). `size` is the number of bytes from `depth` to the end of
/// the buffer; bytes between rows are left as they are. Any size may be asked for: that of the image, see
/// `lsdc_scene_size`, gives a depth for each of its pixels. If the call fails, the buffer is unchanged.
lsdc_status lsdc_completion_depth(const struct lsdc_completion *completion,
                                  size_t width,
                                  size_t height,
                                  float *depth,
                                  size_t size,
                                  size_t stride);

/// Writes the standard deviation of the error of the depth at every pixel, in the unit of the points: half
/// the width of the interval around the depth that holds 68.27 % of errors. Otherwise as
/// `lsdc_completion_depth`. Fails with `LSDC_ERROR_FIT` if there are too few points to tell.
lsdc_status lsdc_completion_standard_deviation(const struct lsdc_completion *completion,
                                               size_t width,
                                               size_t height,
                                               float *deviation,
                                               size_t size,
                                               size_t stride);

/// Writes the number of standard deviations around the depth that hold a share `level` of errors, between 0
/// and 1: 95 % need more than 1.96.
lsdc_status lsdc_completion_interval(const struct lsdc_completion *completion,
                                     double level,
                                     double *deviations);

/// Writes the depth at `count` positions of the image, which may lie between pixels; see `lsdc_points` for
/// `x` and `y`. Fails with `LSDC_ERROR_FIT`, and writes nothing, if one is outside the image.
lsdc_status lsdc_completion_depth_at(const struct lsdc_completion *completion,
                                     const double *x,
                                     const double *y,
                                     float *depth,
                                     size_t count);

/// Writes the report.
lsdc_status lsdc_completion_report(const struct lsdc_completion *completion,
                                   struct lsdc_report *report);

/// Writes, for each of the `count` points given, its depth minus the fitted depth; NaN for those that were
/// not used. `count` must be `given` of the report.
lsdc_status lsdc_completion_residuals(const struct lsdc_completion *completion,
                                      double *residuals,
                                      size_t count);

/// Writes, for each of the `count` points given, its depth minus what a fit to all others predicts; NaN for
/// those that were not used, and those that the fit passes through whatever their depths are. `count` must be
/// `given` of the report.
lsdc_status lsdc_completion_leave_one_out(const struct lsdc_completion *completion,
                                          double *errors,
                                          size_t count);

/// Writes the root mean square of the leave-one-out errors, which estimates the error of the depth between
/// the points; NaN if no point has one.
lsdc_status lsdc_completion_leave_one_out_error(const struct lsdc_completion *completion,
                                                double *error);

/// Writes the final weight of each of the `count` points given: 1 in a plain fit without sigmas, less for a
/// point that a robust fit trusts less, or that has a larger sigma; NaN for those that were not used. `count`
/// must be `given` of the report.
lsdc_status lsdc_completion_point_weights(const struct lsdc_completion *completion,
                                          double *weights,
                                          size_t count);

/// Lists the points that are more likely wrong than right, worst first. Writes the first `capacity` of them
/// to `outliers`, which may be null if that is 0, and the number of all to `*count`. `outlier_size` is
/// `sizeof(lsdc_outlier)`.
lsdc_status lsdc_completion_outliers(const struct lsdc_completion *completion,
                                     struct lsdc_outlier *outliers,
                                     size_t capacity,
                                     size_t outlier_size,
                                     size_t *count);

/// Frees a completion; null is ignored. Calls that use it at this moment are not affected. A handle that was
/// freed before is an error, `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_completion_free(struct lsdc_completion *completion);

/// Tests whether points lie where the image of a scene shows them: predicts them from each other (at most 2000 of
/// them) where they are, and moved by 40 shifts of up to a twentieth of the width of the image. It takes as long as some 41
/// fits, and one image hardly ever tells: pool the first five to ten frames of a recording by passing the alignment so
/// far as `before`, which may be null. Fewer than 100 points that are not near the border are no evidence, and no error.
/// `*alignment` becomes a handle to be freed with `lsdc_alignment_free`, or null if the call fails.
lsdc_status lsdc_scene_alignment(const struct lsdc_scene *scene,
                                 const struct lsdc_points *points,
                                 const struct lsdc_alignment *before,
                                 struct lsdc_alignment **alignment);

/// Writes the best of the shifts, clear or not.
lsdc_status lsdc_alignment_shift(const struct lsdc_alignment *alignment, struct lsdc_shift *shift);

/// Frees an alignment; null is ignored. A handle that was freed before is an error, `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_alignment_free(struct lsdc_alignment *alignment);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* LSDC_H */
