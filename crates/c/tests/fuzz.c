// Random arguments: nulls, sizes, strides, formats, values, and handles that are live, freed or invalid. Every call returns a
// status, and the library remains usable. To be run under sanitizers and valgrind.
//
//     fuzz CALLS SEED
//
// Only one promise is kept: a buffer is as long as its declared size. Each buffer is allocated with exactly that length.

#include "check.h"

enum { KEPT = 6, INTERNAL = LSDC_ERROR_INTERNAL };

static uint64_t state;
static uint64_t statuses[INTERNAL + 1];

static uint64_t below(uint64_t n) { return next_random(&state) % n; }
static int once_in(uint64_t n) { return below(n) == 0; }

static size_t extreme(void) {
    const size_t values[] = {0, 1, 2, 3, 7, 1 << 15, (size_t)1 << 30, SIZE_MAX, SIZE_MAX / 2, SIZE_MAX - 7};
    return once_in(2) ? values[below(10)] : (size_t)next_random(&state) >> below(64);
}

static double number(void) {
    const double values[] = {0.0, -0.0, -1.0, NAN, INFINITY, -INFINITY, 1e300, 1e-300, 1e38, 1e-38, -1e-15};
    return once_in(6) ? values[below(11)] : 1.0 + 3.0 * uniform(&state);
}

// Handles of one kind, including freed ones.
struct handles {
    void *all[KEPT];
};

static void *any(struct handles *handles) {
    if (once_in(40)) return NULL;
    if (once_in(40)) return (void *)(uintptr_t)next_random(&state);
    if (once_in(40)) return handles;
    return handles->all[below(KEPT)];
}

// Keeps the handle created by a call in the place of another one.
static lsdc_status made(lsdc_status status, void *handle, struct handles *handles,
                        lsdc_status (*release)(void *)) {
    CHECK((status == LSDC_OK) == (handle != NULL));
    if (handle != NULL) {
        uint64_t place = below(KEPT);
        if (handles->all[place] != NULL) release(handles->all[place]);
        handles->all[place] = handle;
    }
    return status;
}

static struct handles completers, scenes, completions;

static lsdc_status free_completer(void *handle) { return lsdc_completer_free((lsdc_completer *)handle); }
static lsdc_status free_scene(void *handle) { return lsdc_scene_free((lsdc_scene *)handle); }
static lsdc_status free_completion(void *handle) { return lsdc_completion_free((lsdc_completion *)handle); }

static void *allocated(size_t bytes) {
    void *memory = malloc(bytes);
    CHECK(memory != NULL || bytes == 0);
    return memory;
}

static void spoil(size_t *field) {
    if (once_in(25)) *field = extreme();
}

// As `spoil`, for sizes that determine time and memory: large values are too large for any buffer.
static void spoil_side(size_t *field) {
    spoil(field);
    if (*field > 64 && *field < 1 << 20) *field %= 64;
}

static size_t struct_size(size_t right) { return once_in(30) ? extreme() % (right + 1) : right; }

static lsdc_status create_completer(void) {
    lsdc_completer_options options = quick();
    options.struct_size = struct_size(sizeof options);
    options.threads = below(3);
    // More threads than a process can have.
    if (once_in(10)) options.threads = SIZE_MAX - below(100);
    if (once_in(10)) options.working_width = below(40);
    if (once_in(10)) options.working_height = SIZE_MAX - below(100);
    if (once_in(10)) options.encoder_side = below(600);
    options.fit = (lsdc_fit)below(5);
    options.robust = (lsdc_robust)below(9);
    // Without options, images would be resized to the large size of training.
    if (options.struct_size < sizeof options) options.struct_size = 0;
    uint8_t garbage[64];
    for (size_t i = 0; i < sizeof garbage; ++i) garbage[i] = (uint8_t)below(256);
    garbage[63] = 0;
    lsdc_completer *completer = (lsdc_completer *)garbage, **out = once_in(20) ? NULL : &completer;
    lsdc_status status;
    switch (below(8)) {
    case 0: status = lsdc_completer_create((const char *)garbage, &options, out); break;
    case 1: status = lsdc_completer_create_from_file((const char *)garbage, &options, out); break;
    case 2: status = lsdc_completer_create_from_memory(garbage, below(65), &options, out); break;
    case 3: status = lsdc_completer_create(once_in(2) ? NULL : "none", &options, out); break;
    default: status = lsdc_completer_create("small", &options, out);
    }
    return out == NULL ? status : made(status, completer, &completers, free_completer);
}

static void fill_floats(float *values, size_t count) {
    for (size_t i = 0; i < count; ++i) values[i] = once_in(3) ? (float)number() : 0.0f;
}

// A map of a size that a scene may have. The caller frees `*memory`.
static lsdc_map random_map(size_t width, size_t height, void **memory) {
    lsdc_map map = map_of(NULL, width, height);
    map.format = (lsdc_depth_format)below(2);
    size_t row = width * (map.format == LSDC_U16 ? 2 : 4);
    if (once_in(3)) map.stride = row + below(9);
    map.size = (map.stride ? map.stride : row) * height;
    if (once_in(15)) map.size = below(2 * map.size + 2);
    if (map.format == LSDC_U16 || once_in(4)) map.unit = once_in(8) ? number() : 0.001;
    *memory = allocated(map.size);
    if (map.size > 0) memset(*memory, 0, map.size);
    if (map.format == LSDC_F32) fill_floats((float *)*memory, map.size / sizeof(float));
    for (size_t i = 0; map.format == LSDC_U16 && i < map.size / 2; ++i) {
        ((uint16_t *)*memory)[i] = (uint16_t)(once_in(3) ? below(65536) : 0);
    }
    map.data = once_in(30) ? NULL : *memory;
    map.struct_size = struct_size(sizeof map);
    spoil_side(&map.width);
    spoil_side(&map.height);
    spoil(&map.stride);
    if (once_in(40)) map.format = (lsdc_depth_format)next_random(&state);
    if (once_in(40)) map.reserved = 1;
    return map;
}

// The output of a network for "small" or "none". The caller frees its maps.
static lsdc_network_output random_output(void) {
    lsdc_network_output output;
    memset(&output, 0, sizeof output);
    output.struct_size = struct_size(sizeof output);
    output.functions = once_in(3) ? 1 : once_in(8) ? below(70) : 65;
    output.width = 1 + below(12);
    output.height = 1 + below(12);
    size_t pixels = output.width * output.height, values = output.functions * pixels;
    float *basis = (float *)allocated(values * sizeof *basis), *affinities = (float *)allocated(2 * pixels * sizeof *basis);
    for (size_t i = 0; i < values; ++i) basis[i] = (float)(once_in(5000) ? number() : uniform(&state));
    for (size_t i = 0; i < 2 * pixels; ++i) affinities[i] = (float)(once_in(1000) ? number() : uniform(&state));
    output.basis = basis;
    output.affinities = affinities;
    // Larger values must be too large for any memory.
    if (once_in(30)) output.functions = SIZE_MAX / 2;
    if (once_in(30)) output.width = SIZE_MAX - below(100);
    if (once_in(30)) output.height = 0;
    return output;
}

static lsdc_status read_network_input(void) {
    size_t width, height, columns = 1 + below(24), rows = 1 + below(24);
    lsdc_completer *completer = (lsdc_completer *)any(&completers);
    lsdc_status status = lsdc_completer_network_size(completer, columns, rows, &width, &height);
    if (status != LSDC_OK || width * height > 1 << 16) return status;
    uint8_t *rgb = (uint8_t *)allocated(3 * columns * rows);
    paint(rgb, columns, rows, next_random(&state));
    lsdc_image image = image_of(rgb, columns, rows);
    size_t size = 3 * sizeof(float) * width * height;
    if (once_in(10)) size = below(size);
    float *values = (float *)allocated(size);
    status = lsdc_completer_network_input(completer, &image, once_in(30) ? NULL : values, size);
    free(values);
    free(rgb);
    return status;
}

static lsdc_status create_scene(void) {
    const lsdc_format formats[] = {0, 1, 2, 3, 4, 16, 17, 18, 19, 20};
    const size_t bytes[] = {3, 3, 1, 4, 4, 12, 12, 4, 16, 16};
    size_t which = below(10), width = 1 + below(24), height = 1 + below(24), row = width * bytes[which];
    lsdc_image image = image_of(NULL, width, height);
    image.format = formats[which];
    if (once_in(3)) image.stride = row + below(9);
    image.size = (image.stride ? image.stride : row) * height;
    if (once_in(15)) image.size = below(2 * image.size + 2);
    uint8_t *memory = (uint8_t *)allocated(image.size);
    for (size_t i = 0; i < image.size; ++i) memory[i] = (uint8_t)below(256);
    if (which > 4 && !once_in(4)) {
        for (size_t i = 0; i + 4 <= image.size; i += 4) {
            float value = (float)uniform(&state);
            memcpy(memory + i, &value, 4);
        }
        image.stride = 0;
        image.size = row * height < image.size ? row * height : image.size;
    }
    image.data = once_in(30) ? NULL : memory;
    image.struct_size = struct_size(sizeof image);
    spoil_side(&image.width);
    spoil_side(&image.height);
    spoil(&image.stride);
    if (once_in(30)) image.format = (lsdc_format)next_random(&state);
    if (once_in(40)) image.reserved = 1;

    void *values = NULL;
    lsdc_map guide = random_map(1 + below(20), 1 + below(20), &values);
    lsdc_scene_options options;
    memset(&options, 0, sizeof options);
    options.struct_size = struct_size(sizeof options);
    options.guide = once_in(4) ? &guide : NULL;
    options.guide_kind = (lsdc_guide_kind)below(4);
    if (once_in(40)) options.reserved = 1;
    lsdc_network_output output = random_output();
    options.output = once_in(4) ? &output : NULL;
    lsdc_scene *scene = (lsdc_scene *)&options, **out = once_in(30) ? NULL : &scene;
    lsdc_status status = lsdc_scene_create((lsdc_completer *)any(&completers), once_in(40) ? NULL : &image,
                                           once_in(3) ? NULL : &options, out);
    free((void *)(uintptr_t)output.basis);
    free((void *)(uintptr_t)output.affinities);
    free(values);
    free(memory);
    return out == NULL ? status : made(status, scene, &scenes, free_scene);
}

static lsdc_complete_options random_options(void) {
    lsdc_complete_options options;
    options.struct_size = struct_size(sizeof options);
    options.previous = once_in(3) ? (lsdc_completion *)any(&completions) : NULL;
    return options;
}

static lsdc_status complete(void) {
    size_t count = below(60), stride = once_in(3) ? 8 + below(30) : 0;
    size_t apart[2] = {stride ? stride : 8, stride ? stride : 4};
    size_t sizes[4];
    uint8_t *arrays[4];
    for (int i = 0; i < 4; ++i) {
        sizes[i] = count == 0 ? 0 : apart[i / 2] * (count - 1) + (i < 2 ? 8 : 4);
        arrays[i] = (uint8_t *)allocated(sizes[i]);
        for (size_t k = 0; k < count; ++k) {
            double value = i < 2 ? (once_in(20) ? number() : uniform(&state) * 24.0) : number();
            float single = (float)value;
            memcpy(arrays[i] + k * apart[i / 2], i < 2 ? (void *)&value : (void *)&single, i < 2 ? 8 : 4);
        }
    }
    lsdc_points points;
    memset(&points, 0, sizeof points);
    points.struct_size = struct_size(sizeof points);
    points.count = count;
    points.stride = stride;
    points.x = once_in(30) ? NULL : (const double *)(void *)arrays[0];
    points.y = once_in(30) ? NULL : (const double *)(void *)arrays[1];
    points.depth = once_in(30) ? NULL : (const float *)(void *)arrays[2];
    points.sigma = once_in(2) ? NULL : (const float *)(void *)arrays[3];
    // Shorter strides stay within the arrays; longer ones must be too long for any memory.
    if (once_in(20)) points.stride = once_in(2) ? below(8) : SIZE_MAX - below(1000);
    if (once_in(20)) points.count = SIZE_MAX - below(1000);
    lsdc_complete_options options = random_options();
    lsdc_completion *completion = (lsdc_completion *)&options, **out = once_in(30) ? NULL : &completion;
    lsdc_status status =
        lsdc_scene_complete((lsdc_scene *)any(&scenes), once_in(40) ? NULL : &points, once_in(3) ? NULL : &options, out);
    for (int i = 0; i < 4; ++i) free(arrays[i]);
    return out == NULL ? status : made(status, completion, &completions, free_completion);
}

static lsdc_status complete_map(void) {
    lsdc_scene *scene = (lsdc_scene *)any(&scenes);
    size_t width, height;
    if (once_in(10) || lsdc_scene_size(scene, &width, &height) != LSDC_OK) {
        width = 1 + below(24);
        height = 1 + below(24);
    }
    void *memory[2] = {NULL, NULL};
    lsdc_map depth = random_map(width, height, &memory[0]), sigma = random_map(width, height, &memory[1]);
    lsdc_complete_options options = random_options();
    lsdc_completion *completion = (lsdc_completion *)&options, **out = once_in(30) ? NULL : &completion;
    lsdc_status status = lsdc_scene_complete_map(scene, once_in(40) ? NULL : &depth, once_in(2) ? NULL : &sigma,
                                                 once_in(3) ? NULL : &options, out);
    free(memory[0]);
    free(memory[1]);
    return out == NULL ? status : made(status, completion, &completions, free_completion);
}

static lsdc_status read_map(void) {
    size_t width = below(40), height = below(40), row = 4 * width, stride = once_in(2) ? 0 : row + below(9);
    size_t size = (stride ? stride : row) * height;
    if (once_in(10)) size = below(size + 1);
    uint8_t *memory = (uint8_t *)allocated(size);
    if (size > 0) memset(memory, 0x5a, size);
    spoil_side(&width);
    spoil_side(&height);
    spoil(&stride);
    lsdc_completion *completion = (lsdc_completion *)any(&completions);
    float *data = once_in(30) ? NULL : (float *)(void *)memory;
    lsdc_status status = once_in(2) ? lsdc_completion_depth(completion, width, height, data, size, stride)
                                    : lsdc_completion_standard_deviation(completion, width, height, data, size, stride);
    for (size_t i = 0; status != LSDC_OK && i < size; ++i) CHECK(memory[i] == 0x5a);
    if (status == LSDC_OK) {
        for (size_t y = 0; y < height; ++y) {
            for (size_t x = 0; x < width; ++x) {
                float value;
                memcpy(&value, memory + y * (stride ? stride : 4 * width) + 4 * x, 4);
                CHECK(isfinite(value) && value >= 0.0f);
            }
        }
    }
    free(memory);
    return status;
}

static lsdc_status read_points(void) {
    lsdc_completion *completion = (lsdc_completion *)any(&completions);
    lsdc_report report;
    memset(&report, 0, sizeof report);
    report.struct_size = struct_size(sizeof report);
    lsdc_status status = lsdc_completion_report(completion, once_in(30) ? NULL : &report);
    if (status != LSDC_OK || report.struct_size < sizeof report) return status;
    CHECK(report.given == report.used + report.invalid + report.outside && report.used > 0);
    size_t count = once_in(10) ? below(100) : report.given;
    double *values = (double *)allocated(count * sizeof *values), x = number(), y = number(), value;
    double *data = once_in(30) ? NULL : values;
    lsdc_outlier *outliers;
    float depth;
    switch (below(7)) {
    case 0: status = lsdc_completion_residuals(completion, data, count); break;
    case 1: status = lsdc_completion_leave_one_out(completion, data, count); break;
    case 2: status = lsdc_completion_point_weights(completion, data, count); break;
    case 3: status = lsdc_completion_leave_one_out_error(completion, once_in(20) ? NULL : &value); break;
    case 4: status = lsdc_completion_interval(completion, once_in(3) ? number() : uniform(&state), &value); break;
    case 5: status = lsdc_completion_depth_at(completion, &x, &y, once_in(20) ? NULL : &depth, below(2)); break;
    default:
        count = below(5);
        outliers = (lsdc_outlier *)allocated(count * sizeof *outliers);
        status = lsdc_completion_outliers(completion, once_in(20) ? NULL : outliers, count,
                                          once_in(20) ? extreme() : sizeof *outliers, &count);
        free(outliers);
    }
    free(values);
    return status;
}

static lsdc_status release(void) {
    switch (below(3)) {
    case 0:
        if (once_in(2)) return lsdc_completer_release((lsdc_completer *)any(&completers));
        return lsdc_completer_free((lsdc_completer *)any(&completers));
    case 1: return lsdc_scene_free((lsdc_scene *)any(&scenes));
    default: return lsdc_completion_free((lsdc_completion *)any(&completions));
    }
}

int main(int count, char **arguments) {
    CHECK(count == 3);
    uint64_t calls = strtoull(arguments[1], NULL, 10);
    state = strtoull(arguments[2], NULL, 10);
    lsdc_status (*const all[])(void) = {create_scene, complete, complete,    complete_map,      read_map,
                                        read_map,     read_points, read_points, read_network_input};
    for (int i = 0; i < KEPT; ++i) {
        while (create_completer() != LSDC_OK) continue;
        while (create_scene() != LSDC_OK) continue;
        while (complete() != LSDC_OK) continue;
    }
    for (uint64_t i = 0; i < calls; ++i) {
        lsdc_status status = once_in(20) ? create_completer() : once_in(20) ? release() : all[below(9)]();
        // Neither an internal error nor an unknown status.
        CHECK(status >= LSDC_OK && status < INTERNAL);
        CHECK(status == LSDC_OK || *lsdc_last_error() != '\0');
        statuses[status] += 1;
    }
    for (int i = 0; i < KEPT; ++i) {
        lsdc_completion_free((lsdc_completion *)completions.all[i]);
        lsdc_scene_free((lsdc_scene *)scenes.all[i]);
        lsdc_completer_free((lsdc_completer *)completers.all[i]);
    }
    printf("fuzz: %llu calls, by status:", (unsigned long long)calls);
    for (int i = 0; i < INTERNAL; ++i) printf(" %llu", (unsigned long long)statuses[i]);
    puts("");
    // All statuses occur except a lack of memory.
    for (int i = LSDC_OK; calls >= 1000 && i <= LSDC_ERROR_FIT; ++i) CHECK(statuses[i] > 0);
    return EXIT_SUCCESS;
}
