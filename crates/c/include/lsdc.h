// lsdc: an RGB image and a few sparse depths in, a dense depth map out.
//
// An lsdc_completer runs the network on an image once and creates an lsdc_scene. A scene can be fitted to
// points any number of times, each giving an lsdc_completion, which returns depth, standard deviations,
// residuals and outliers.
//
// Units. Depths are along the optical axis, in metres or any other unit; results are in the same unit.
// Positions are in pixels: x to the right, y down, (0, 0) is the centre of the first pixel.
// Strides and sizes of buffers are in bytes.
//
// Errors. A function returns LSDC_OK or one of LSDC_ERROR_...; lsdc_last_error() and lsdc_last_hint() give
// the message of the last error on the calling thread and a hint at a remedy. A failed call changes only the
// handle that it would have returned, which becomes null, or the count of outliers, which becomes 0.
//
// Ownership. Data passed by the caller is copied and may be freed or changed once the call returns. Handles
// belong to the caller, who frees each once, in any order; they are numbers, not addresses. Null, freed and
// foreign handles give an error. The library cannot check that a buffer is as long as its declared size.
//
// Threads. Every function may be called from any number of threads at once, also on the same handle: handles
// are immutable. The same input gives the same bits for any number of threads. After fork(), a child process
// must create its own completer: computing with its parent's handles gives LSDC_ERROR_HANDLE.
//
// Structures begin with their size, so fields can be added at their end and programs compiled with an older
// header keep working. Set struct_size, and leave fields that you do not need 0:
//
//     lsdc_image image = {.struct_size = sizeof image, .data = pixels, .size = 3 * 640 * 480,
//                         .width = 640, .height = 480, .format = LSDC_RGB8};
//
// Written by cbindgen from the sources of lsdc-c. Do not edit.


#ifndef LSDC_H
#define LSDC_H

#include <stddef.h>
#include <stdint.h>

/// Version of this interface, which is part of the name of the shared library (`liblsdc.so.1`). It increases
/// if programs compiled with an older header would no longer work.
#define LSDC_ABI_VERSION 1

/// Evidence from one or more frames of a shift between points and images, caused by wrong extrinsics or time stamps.
typedef struct lsdc_alignment lsdc_alignment;

/// A trained network, the settings of the fit, and threads.
typedef struct lsdc_completer lsdc_completer;

/// A scene fitted to points. Results beyond the fit are computed on request.
typedef struct lsdc_completion lsdc_completion;

/// Everything that depends only on an image: the network has run, and each set of points needs only a fit.
typedef struct lsdc_scene lsdc_scene;

/// The result of a call: `LSDC_OK`, or one of the codes `LSDC_ERROR_...`.
typedef int32_t lsdc_status;

/// The model of depth: one of the constants `LSDC_FIT_...`.
typedef uint32_t lsdc_fit;

/// How the influence of outliers is limited: one of the constants `LSDC_ROBUST_...`.
typedef uint32_t lsdc_robust;

/// Settings of a completer; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_completer_options)`.
typedef struct lsdc_completer_options {
    /// `sizeof(lsdc_completer_options)`.
    size_t struct_size;
    /// Number of separate threads, at most 4096. 0 means the shared threads of such completers, one per core.
    size_t threads;
    /// With `working_height`: images are resized to about the number of pixels of this size, keeping their aspect
    /// ratio, before they enter the network. Both 0 means the size of the training images.
    size_t working_width;
    /// See `working_width`.
    size_t working_height;
    /// The model of depth.
    lsdc_fit fit;
    /// How the influence of outliers is limited.
    lsdc_robust robust;
    /// Size of the image that the encoder of "anything" reads: the shorter side of one of 4:3 with as many pixels, from 252 to
    /// 518. 0 means 336, with which it was trained. Other weights take 0 only.
    size_t encoder_side;
} lsdc_completer_options;

/// The order and type of the colours of a pixel: one of the constants `LSDC_...8` and `LSDC_...F32`.
typedef uint32_t lsdc_format;

/// An image in the caller's memory. Set `struct_size` to `sizeof(lsdc_image)`.
typedef struct lsdc_image {
    /// `sizeof(lsdc_image)`.
    size_t struct_size;
    /// The first pixel of the first row. No alignment is needed.
    const void *data;
    /// Bytes of the buffer from `data` to the last pixel, or to the end of the last row's stride.
    size_t size;
    /// Number of columns.
    size_t width;
    /// Number of rows; width times height is at most 2^30.
    size_t height;
    /// Bytes from the start of one row to the next; 0 means no gaps.
    size_t stride;
    /// One of the constants `LSDC_RGB8` to `LSDC_BGRA_F32`.
    lsdc_format format;
    /// 0.
    uint32_t reserved;
} lsdc_image;

/// The type of the values of a map: `LSDC_F32` or `LSDC_U16`.
typedef uint32_t lsdc_depth_format;

/// A map of depths, standard deviations or guide values in the caller's memory. Set `struct_size` to
/// `sizeof(lsdc_map)`.
typedef struct lsdc_map {
    /// `sizeof(lsdc_map)`.
    size_t struct_size;
    /// The first value of the first row. No alignment is needed.
    const void *data;
    /// Bytes of the buffer from `data` to the last value, or to the end of the last row's stride.
    size_t size;
    /// Number of columns.
    size_t width;
    /// Number of rows; width times height is at most 2^30.
    size_t height;
    /// Bytes from the start of one row to the next; 0 means no gaps.
    size_t stride;
    /// The unit of the values in metres: 0.001 for millimetres. Required for integers; for floats, 0 means 1.
    double unit;
    /// `LSDC_F32` or `LSDC_U16`.
    lsdc_depth_format format;
    /// 0.
    uint32_t reserved;
} lsdc_map;

/// Quantity of the values of a guide, up to scale and shift: one of the constants `LSDC_GUIDE_...`.
typedef uint32_t lsdc_guide_kind;

/// Basis functions and affinities of an image, computed by another program, such as ONNX Runtime with the graph of
/// `lsdc weights export`. Set `struct_size` to `sizeof(lsdc_network_output)`.
typedef struct lsdc_network_output {
    /// `sizeof(lsdc_network_output)`.
    size_t struct_size;
    /// The output `basis` of the graph: `functions` maps of `height` rows of `width` values, without gaps.
    const float *basis;
    /// The output `affinities`: two such maps, of each pixel with its right and its lower neighbour. Not negative.
    const float *affinities;
    /// Number of basis functions, which must match the completer's weights.
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
    /// A dense depth prediction for the image from another source, of any size, or null. Unit, scale and shift need
    /// not be known; NaN marks gaps. Null means the prediction of the depth head of "anything", if it is installed.
    const struct lsdc_map *guide;
    /// Quantity of the guide's values.
    lsdc_guide_kind guide_kind;
    /// 0.
    uint32_t reserved;
    /// The output of the network for this image, computed by another program, or null to run the network. Any size is
    /// possible; a fit with a field is solved at this size. Functions are interpolated at points between its pixels.
    const struct lsdc_network_output *output;
} lsdc_scene_options;

/// Known depths at some positions of an image, in the caller's memory. Set `struct_size` to
/// `sizeof(lsdc_points)`.
///
/// With a stride of 0, `x`, `y`, `depth` and `sigma` are arrays of `count` values; otherwise they point to
/// fields of the first of `count` structures that are `stride` bytes apart.
typedef struct lsdc_points {
    /// `sizeof(lsdc_points)`.
    size_t struct_size;
    /// Number of points, at most 2^30.
    size_t count;
    /// Columns, which may lie between pixels: 0 is the centre of the first, the image ends at `width - 0.5`.
    const double *x;
    /// Rows, downwards: 0 is the centre of the first, the image ends at `height - 0.5`.
    const double *y;
    /// Depths along the optical axis, in metres or any other unit; results are in the same unit.
    const float *depth;
    /// Standard deviations of the depths in the same unit; null if all are unknown. Values that are not positive and
    /// finite mean unknown, and are counted in `lsdc_report.without_deviation` if others are known.
    const float *sigma;
    /// Bytes from one point to the next in all arrays; 0 means no gaps.
    size_t stride;
} lsdc_points;

/// Settings of a completion; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_complete_options)`.
typedef struct lsdc_complete_options {
    /// `sizeof(lsdc_complete_options)`.
    size_t struct_size;
    /// The completion of the previous frame of a video, which regularises this one, or null. Both must come from
    /// completers with the same weights and fit.
    const struct lsdc_completion *previous;
} lsdc_complete_options;

/// Statistics of a fit. Set `struct_size` to `sizeof(lsdc_report)`.
typedef struct lsdc_report {
    /// `sizeof(lsdc_report)`.
    size_t struct_size;
    /// Number of points given: `used + invalid + outside`.
    size_t given;
    /// Number of points fitted.
    size_t used;
    /// Points left out because their depth is not from 1e-15 to 1e15, or their position is not finite.
    size_t invalid;
    /// Points left out because they are outside the image.
    size_t outside;
    /// Points used without a positive and finite sigma, if others have one.
    size_t without_deviation;
    /// Number of directions that the points determine, at most `functions`.
    size_t rank;
    /// Number of basis functions of the network, including the constant.
    size_t functions;
    /// Root mean square of the residuals, in the unit of the points.
    double residual;
    /// The strength of the prior; NaN if there is none.
    double lambda;
    /// Trust in the guide, 0 if the points do not support it; NaN if there was none.
    double guide_trust;
    /// Lower limit of depths: a tenth of the smallest given depth. Below 0.7 times the smallest, the fitted depth is continued
    /// linearly in inverse depth.
    double lowest;
    /// Upper limit of depths: ten times the largest given depth.
    double highest;
    /// Run time of the network in seconds.
    double network_seconds;
    /// Run time of the fit in seconds, including `field_seconds` and `solve_seconds`.
    double fit_seconds;
    /// Run time of the preparation that only the first fit to an image needs, in seconds.
    double field_seconds;
    /// Run time of the solver in seconds.
    double solve_seconds;
    /// The model of depth: `LSDC_FIT_LSE`, `LSDC_FIT_FIELD` or `LSDC_FIT_JOINT`.
    lsdc_fit fit;
    /// 0.
    uint32_t reserved;
    /// Share of the median in the map: 0 is the joint fit, 1 the median of this fit, of the field alone, and of the surface
    /// spanned by the points; NaN for other fits, and for points that span no surface.
    double median_share;
    /// Pixels that show sky without a point near, by the depth head of `anything`: their standard deviation is at least their
    /// depth, whose value means nothing.
    size_t sky_pixels;
} lsdc_report;

/// A point that is more likely an outlier than an inlier, judged by the other points.
typedef struct lsdc_outlier {
    /// Its index among the given points, from 0.
    size_t index;
    /// Its column.
    double x;
    /// Its row.
    double y;
    /// Its depth.
    double depth;
    /// Probability that it is an outlier, from 0.5 to 1.
    double probability;
    /// Its depth minus the prediction from the other points, over the scale of the errors of inliers there;
    /// positive if it is farther away.
    double score;
    /// Its depth minus the prediction from the other points.
    double error;
    /// Its weight in a robust fit.
    double weight;
} lsdc_outlier;

/// The shift at which the points fit the images best. Set `struct_size` to `sizeof(lsdc_shift)`.
typedef struct lsdc_shift {
    /// `sizeof(lsdc_shift)`.
    size_t struct_size;
    /// To the right, in pixels of the image; NaN without evidence.
    double x;
    /// Down, in pixels of the image; NaN without evidence.
    double y;
    /// Mean leave-one-out error of the unshifted points, relative to their depth; NaN without evidence.
    double error;
    /// The same error of the shifted points.
    double error_moved;
    /// Gain in log-likelihood, divided by its standard error; 0 without evidence.
    double standard_errors;
    /// Number of points compared in all frames.
    size_t points;
    /// Number of frames with evidence.
    size_t frames;
    /// 1 if chance does not explain the shift: the gain is 6 standard errors in five frames or more, 9 in fewer, and the
    /// shift lowers the error by 5 %. Check extrinsics and time stamps then. Otherwise 0.
    uint32_t is_clear;
    /// 0.
    uint32_t reserved;
} lsdc_shift;

/// The call succeeded.
#define LSDC_OK 0

/// A pointer is null, a structure has an impossible `struct_size`, or a constant is unknown.
#define LSDC_ERROR_ARGUMENT 1

/// A handle was freed before, does not belong to this library, or was created before `fork()`.
#define LSDC_ERROR_HANDLE 2

/// The size, the stride or the number of pixels of a buffer does not match its contents.
#define LSDC_ERROR_BUFFER 3

/// The colours of an image, or the values of a guide, cannot be used.
#define LSDC_ERROR_IMAGE 4

/// Weights cannot be read, or do not match their network.
#define LSDC_ERROR_WEIGHTS 5

/// A setting is out of range.
#define LSDC_ERROR_SETTINGS 6

/// The fit has no solution: too few usable points.
#define LSDC_ERROR_FIT 7

/// Memory for a copy of the caller's data cannot be allocated.
#define LSDC_ERROR_MEMORY 8

/// A bug in lsdc, which should be reported.
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

/// As `LSDC_RGB8` in floats from 0 (black) to 1 (white); values slightly outside are clamped, above 16 an error.
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

/// Unsigned 16-bit integers in the byte order of the machine.
#define LSDC_U16 1

/// Depths above 0.
#define LSDC_GUIDE_DEPTH 0

/// Inverse depths (larger is nearer), as MiDaS and Depth Anything predict.
#define LSDC_GUIDE_DISPARITY 1

/// Logarithms of depths.
#define LSDC_GUIDE_LOG 2

/// With a null guide: no guide, not even from the depth head of "anything".
#define LSDC_GUIDE_NONE 3

/// The model for which the weights were trained.
#define LSDC_FIT_DEFAULT 0

/// Basis functions only: least squares as in the paper.
#define LSDC_FIT_LSE 1

/// A field only, which is smooth except across edges.
#define LSDC_FIT_FIELD 2

/// Basis functions and a field.
#define LSDC_FIT_JOINT 3

/// The setting of the weights; the weights of the library do not limit the influence.
#define LSDC_ROBUST_DEFAULT 0

/// No limit.
#define LSDC_ROBUST_NONE 1

/// Weights each point by its probability of being an inlier, judged by the other points.
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

/// Returns the error message of the last failed call on this thread: one sentence in UTF-8, or "" if no call
/// has failed yet. Successful calls do not change it. The text belongs to the library and is valid until the
/// next failed call on this thread, or the end of the thread.
const char *lsdc_last_error(void);

/// Returns a hint at a remedy for the error of `lsdc_last_error`, or "" if there is none. It is valid as long.
const char *lsdc_last_hint(void);

/// Returns the version of the library, such as "0.2.0". The text is valid for the lifetime of the program.
const char *lsdc_version(void);

/// Returns the interface version of the loaded library. A program can compare it with `LSDC_ABI_VERSION`, the
/// version of the header with which it was compiled.
uint32_t lsdc_abi_version(void);

/// Creates a completer with weights of the library: "default", the most accurate without an installation; "small",
/// which take two thirds of the time; "anything", the most accurate of all; or "none", no network, for scenes with a
/// guide. "anything" needs an encoder, which the program `lsdc` installs once in the user's data folder: `lsdc weights
/// get anything`, or offline `lsdc weights add FILE`; LSDC_WEIGHTS names another folder. `options` may be null.
/// `*completer` becomes a handle to be freed with `lsdc_completer_free`, or null if the call fails.
lsdc_status lsdc_completer_create(const char *weights,
                                  const struct lsdc_completer_options *options,
                                  struct lsdc_completer **completer);

/// Creates a completer with weights from a file, as `lsdc train` writes them. `path` is null-terminated, and
/// UTF-8 on Windows. Otherwise as `lsdc_completer_create`.
lsdc_status lsdc_completer_create_from_file(const char *path,
                                            const struct lsdc_completer_options *options,
                                            struct lsdc_completer **completer);

/// Creates a completer with weights from the `size` bytes of such a file in memory, which are not needed
/// afterwards. Otherwise as `lsdc_completer_create`.
lsdc_status lsdc_completer_create_from_memory(const void *data,
                                              size_t size,
                                              const struct lsdc_completer_options *options,
                                              struct lsdc_completer **completer);

/// Frees the memory that a completer keeps for further images, and the memory that all completers keep for further
/// fits. With glibc, it also returns all free memory of the process to the system. Programs with little memory call
/// it after `lsdc_scene_create`; later calls allocate again.
lsdc_status lsdc_completer_release(const struct lsdc_completer *completer);

/// Frees a completer; null is ignored. Its scenes, and calls in progress, are not affected. A handle that was
/// freed before gives `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_completer_free(struct lsdc_completer *completer);

/// Writes the size of the network input for an image of `image_width` columns and `image_height` rows.
lsdc_status lsdc_completer_network_size(const struct lsdc_completer *completer,
                                        size_t image_width,
                                        size_t image_height,
                                        size_t *width,
                                        size_t *height);

/// Writes an image as input of the graph of `lsdc weights export`: maps of red, green and blue from 0 to 1, without
/// gaps, each of the size from `lsdc_completer_network_size`. `size` is the number of bytes from `values` to the end of
/// the buffer. If the call fails, the buffer is unchanged.
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

/// Writes the size of the image of a scene.
lsdc_status lsdc_scene_size(const struct lsdc_scene *scene, size_t *width, size_t *height);

/// Fits the scene to points, which are not needed afterwards. Points outside the image, and points whose depth
/// is not from 1e-15 to 1e15, are left out and counted in the report. `options` may be null.
/// `*completion` becomes a handle to be freed with `lsdc_completion_free`, or null if the call fails.
lsdc_status lsdc_scene_complete(const struct lsdc_scene *scene,
                                const struct lsdc_points *points,
                                const struct lsdc_complete_options *options,
                                struct lsdc_completion **completion);

/// Fits the scene to a map of the size of its image, where 0 means no measurement. NaN, infinite and negative
/// values, and 65535 in 16 bits if no other value is near it, are left out and counted in the report as invalid. The
/// points are the pixels that are not 0, row by row. `sigma` is a map of the standard deviations of the depths, or
/// null; values that are not positive and finite mean unknown. Otherwise as `lsdc_scene_complete`.
lsdc_status lsdc_scene_complete_map(const struct lsdc_scene *scene,
                                    const struct lsdc_map *depth,
                                    const struct lsdc_map *sigma,
                                    const struct lsdc_complete_options *options,
                                    struct lsdc_completion **completion);

/// Frees a scene; null is ignored. Its completions, and calls in progress, are not affected. A handle that was
/// freed before gives `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_scene_free(struct lsdc_scene *scene);

/// Writes the dense depth, in the unit of the points, as `height` rows of `width` floats. Rows start `stride`
/// bytes apart; 0 means no gaps. `size` is the number of bytes from `depth` to the end of the buffer; bytes
/// between rows are unchanged. Any size is possible; the size of the image (`lsdc_scene_size`) gives a depth for
/// each of its pixels. If the call fails, the buffer is unchanged.
lsdc_status lsdc_completion_depth(const struct lsdc_completion *completion,
                                  size_t width,
                                  size_t height,
                                  float *depth,
                                  size_t size,
                                  size_t stride);

/// Writes the standard deviation of the depth error at every pixel, in the unit of the points: half the width
/// of the interval around the depth that contains 68.27 % of errors. Otherwise as `lsdc_completion_depth`.
/// Fails with `LSDC_ERROR_FIT` if there are too few points for an estimate.
lsdc_status lsdc_completion_standard_deviation(const struct lsdc_completion *completion,
                                               size_t width,
                                               size_t height,
                                               float *deviation,
                                               size_t size,
                                               size_t stride);

/// Writes the number of standard deviations around the depth that contain a share `level` of errors, between 0
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

/// Writes, for each of the `count` points given, its depth minus the fitted depth; NaN for points that were
/// not used. `count` must be `given` of the report.
lsdc_status lsdc_completion_residuals(const struct lsdc_completion *completion,
                                      double *residuals,
                                      size_t count);

/// Writes, for each of the `count` points given, its depth minus the prediction of a fit to all others; NaN for
/// points that were not used, and for points that the fit interpolates whatever their depths are. `count` must
/// be `given` of the report.
lsdc_status lsdc_completion_leave_one_out(const struct lsdc_completion *completion,
                                          double *errors,
                                          size_t count);

/// Writes the root mean square of the leave-one-out errors, an estimate of the depth error between the points;
/// NaN if no point has such an error.
lsdc_status lsdc_completion_leave_one_out_error(const struct lsdc_completion *completion,
                                                double *error);

/// Writes the final weight of each of the `count` points given: 1 in a plain fit without sigmas, less for points
/// that a robust fit downweights, or that have a larger sigma; NaN for points that were not used. `count` must
/// be `given` of the report.
lsdc_status lsdc_completion_point_weights(const struct lsdc_completion *completion,
                                          double *weights,
                                          size_t count);

/// Lists the points that are more likely outliers than inliers, worst first. Writes the first `capacity` of
/// them to `outliers`, which may be null if `capacity` is 0, and the number of all to `*count`. `outlier_size`
/// is `sizeof(lsdc_outlier)`.
lsdc_status lsdc_completion_outliers(const struct lsdc_completion *completion,
                                     struct lsdc_outlier *outliers,
                                     size_t capacity,
                                     size_t outlier_size,
                                     size_t *count);

/// Frees a completion; null is ignored. Calls in progress are not affected. A handle that was freed before gives
/// `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_completion_free(struct lsdc_completion *completion);

/// Tests whether points are aligned with the image of a scene: predicts at most 2000 of them from each other, unshifted
/// and with 40 shifts of up to a twentieth of the width of the image. It takes as long as about 41 fits. One image is
/// rarely enough: pool the first five to ten frames of a recording by passing the alignment so far as `before`, which
/// may be null. Fewer than 100 points away from the border give no evidence, but no error. `*alignment` becomes a
/// handle to be freed with `lsdc_alignment_free`, or null if the call fails.
lsdc_status lsdc_scene_alignment(const struct lsdc_scene *scene,
                                 const struct lsdc_points *points,
                                 const struct lsdc_alignment *before,
                                 struct lsdc_alignment **alignment);

/// Writes the best shift, whether it is clear or not.
lsdc_status lsdc_alignment_shift(const struct lsdc_alignment *alignment, struct lsdc_shift *shift);

/// Frees an alignment; null is ignored. A handle that was freed before gives `LSDC_ERROR_HANDLE`.
lsdc_status lsdc_alignment_free(struct lsdc_alignment *alignment);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* LSDC_H */
