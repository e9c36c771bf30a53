// Results of a completion: all errors of reading them, and the same bits for any layout.

#include "fixture.h"

static void maps_and_points(void) {
    typedef lsdc_status (*write)(const lsdc_completion *, size_t, size_t, float *, size_t, size_t);
    const write maps[] = {lsdc_completion_depth, lsdc_completion_standard_deviation};
    for (int i = 0; i < PIXELS; ++i) dense[i] = -5.0f;
    for (int i = 0; i < 2; ++i) {
        FAILS(LSDC_ERROR_ARGUMENT, "` is null", maps[i](completion, WIDTH, HEIGHT, NULL, sizeof dense, 0));
        FAILS(LSDC_ERROR_BUFFER, "its buffer has", maps[i](completion, WIDTH, HEIGHT, dense, sizeof dense - 1, 0));
        FAILS(LSDC_ERROR_BUFFER, "overlap", maps[i](completion, WIDTH, HEIGHT, dense, sizeof dense, 4));
        FAILS(LSDC_ERROR_BUFFER, "cannot have", maps[i](completion, 0, HEIGHT, dense, sizeof dense, 0));
        FAILS(LSDC_ERROR_BUFFER, "cannot have", maps[i](completion, SIZE_MAX, 3, dense, sizeof dense, 0));
        FAILS(LSDC_ERROR_BUFFER, "its buffer has", maps[i](completion, 1 << 15, 1 << 15, dense, sizeof dense, 0));
        FAILS(LSDC_ERROR_BUFFER, "exceed all memory",
              maps[i](completion, WIDTH, HEIGHT, dense, sizeof dense, SIZE_MAX / 2));
        FAILS(LSDC_ERROR_BUFFER, "memory ends before", maps[i](completion, 9, 9, (float *)(UINTPTR_MAX - 8), 999, 0));
        FAILS(LSDC_ERROR_ARGUMENT, "`completion` is null", maps[i](NULL, WIDTH, HEIGHT, dense, sizeof dense, 0));
    }
    for (int i = 0; i < PIXELS; ++i) CHECK(dense[i] == -5.0f);

    // Rows an odd number of bytes apart, from an odd address, get the same bits; the gaps are unchanged.
    enum { STRIDE = 4 * WIDTH + 3 };
    static uint8_t odd[1 + STRIDE * HEIGHT];
    memset(odd, 0xa5, sizeof odd);
    OK(lsdc_completion_depth(completion, WIDTH, HEIGHT, dense, sizeof dense, 0));
    OK(lsdc_completion_depth(completion, WIDTH, HEIGHT, (float *)(void *)(odd + 1), sizeof odd - 1, STRIDE));
    for (int y = 0; y < HEIGHT; ++y) {
        const uint8_t *row = odd + 1 + STRIDE * y;
        CHECK(memcmp(row, dense + WIDTH * y, 4 * WIDTH) == 0);
        CHECK(row[-1] == 0xa5 && row[4 * WIDTH] == 0xa5);
    }

    double numbers[101];
    FAILS(LSDC_ERROR_ARGUMENT, "` is null", lsdc_completion_interval(completion, 0.9, NULL));
    const double levels[] = {0.0, 1.0, -1.0, NAN};
    for (int i = 0; i < 4; ++i) {
        FAILS(LSDC_ERROR_SETTINGS, "between 0 and 1", lsdc_completion_interval(completion, levels[i], numbers));
    }
    OK(lsdc_completion_interval(completion, 0.95, numbers));
    CHECK(numbers[0] > 1.9);

    typedef lsdc_status (*each)(const lsdc_completion *, double *, size_t);
    const each lists[] = {lsdc_completion_residuals, lsdc_completion_leave_one_out, lsdc_completion_point_weights};
    for (int i = 0; i < 3; ++i) {
        FAILS(LSDC_ERROR_ARGUMENT, "` is null", lists[i](completion, NULL, 100));
        FAILS(LSDC_ERROR_BUFFER, "99 values for 100 points", lists[i](completion, numbers, 99));
        FAILS(LSDC_ERROR_BUFFER, "101 values for 100 points", lists[i](completion, numbers, 101));
        numbers[100] = 7.0;
        OK(lists[i](completion, numbers, 100));
        CHECK(isfinite(numbers[99]) && numbers[100] == 7.0);
    }
    FAILS(LSDC_ERROR_ARGUMENT, "`error` is null", lsdc_completion_leave_one_out_error(completion, NULL));

    float at[2] = {-5.0f, -5.0f};
    const double x[] = {3.5, WIDTH - 0.4}, y[] = {2.25, 0.0}, nowhere[] = {NAN, 1.0};
    FAILS(LSDC_ERROR_ARGUMENT, "`x` is null", lsdc_completion_depth_at(completion, NULL, y, at, 2));
    FAILS(LSDC_ERROR_ARGUMENT, "`y` is null", lsdc_completion_depth_at(completion, x, NULL, at, 2));
    FAILS(LSDC_ERROR_ARGUMENT, "`depth` is null", lsdc_completion_depth_at(completion, x, y, NULL, 1));
    FAILS(LSDC_ERROR_BUFFER, "exceed all memory", lsdc_completion_depth_at(completion, x, y, at, SIZE_MAX));
    FAILS(LSDC_ERROR_FIT, "not in the image", lsdc_completion_depth_at(completion, x, y, at, 2));
    FAILS(LSDC_ERROR_FIT, "not in the image", lsdc_completion_depth_at(completion, nowhere, y, at, 2));
    CHECK(at[0] == -5.0f);
    OK(lsdc_completion_depth_at(completion, x, y, at, 1));
    CHECK(at[0] > 1.0f && at[1] == -5.0f);
    OK(lsdc_completion_depth_at(completion, NULL, NULL, NULL, 0));
}

static void outliers(void) {
    static float wrong[100];
    memcpy(wrong, depths, sizeof wrong);
    wrong[40] = 20.0f;
    wrong[60] = 0.5f;
    lsdc_points some = points_of(xs, ys, wrong, 100);
    lsdc_completion *made;
    lsdc_outlier found[3];
    size_t count = 9;
    const size_t one = sizeof *found;
    OK(lsdc_scene_complete(scene, &some, NULL, &made));
    FAILS(LSDC_ERROR_ARGUMENT, "`count` is null", lsdc_completion_outliers(made, found, 3, one, NULL));
    FAILS(LSDC_ERROR_ARGUMENT, "outlier_size", lsdc_completion_outliers(made, found, 3, one - 8, &count));
    CHECK(count == 0);
    FAILS(LSDC_ERROR_ARGUMENT, "`outliers` is null", lsdc_completion_outliers(made, NULL, 3, one, &count));
    OK(lsdc_completion_outliers(made, NULL, 0, one, &count));
    CHECK(count >= 2);
    found[1].index = 12345;
    OK(lsdc_completion_outliers(made, found, 1, one, &count));
    CHECK(count >= 2 && found[1].index == 12345);
    CHECK(found[0].index == 40 && found[0].x == xs[40] && found[0].y == ys[40] && found[0].depth == 20.0);
    CHECK(found[0].probability > 0.5 && found[0].error > 10.0);
    OK(lsdc_completion_free(made));
}

// Layouts of the same numbers give the same bits.
static void layouts(void) {
    static float expected[PIXELS];
    OK(lsdc_completion_depth(completion, WIDTH, HEIGHT, expected, sizeof expected, 0));

    enum { STRIDE = 4 * WIDTH + 5 };
    static uint8_t bgra[STRIDE * HEIGHT];
    for (int i = 0; i < PIXELS; ++i) {
        uint8_t *pixel = bgra + i / WIDTH * STRIDE + i % WIDTH * 4;
        for (int c = 0; c < 3; ++c) pixel[c] = rgb[3 * i + 2 - c];
    }
    lsdc_image image = image_of(bgra, WIDTH, HEIGHT);
    image.format = LSDC_BGRA8;
    image.stride = STRIDE;
    image.size = sizeof bgra - 5;
    struct {
        double x, y;
        float depth, sigma;
    } structures[100];
    memset(structures, 0, sizeof structures);
    for (int i = 0; i < 100; ++i) {
        structures[i].x = xs[i];
        structures[i].y = ys[i];
        structures[i].depth = depths[i];
    }
    lsdc_points some = points_of(&structures[0].x, &structures[0].y, &structures[0].depth, 100);
    some.sigma = &structures[0].sigma;
    some.stride = sizeof *structures;
    lsdc_scene *other;
    lsdc_completion *made;
    OK(lsdc_scene_create(completer, &image, NULL, &other));
    OK(lsdc_scene_complete(other, &some, NULL, &made));
    OK(lsdc_completion_depth(made, WIDTH, HEIGHT, dense, sizeof dense, 0));
    CHECK(memcmp(dense, expected, sizeof dense) == 0);
    OK(lsdc_completion_free(made));
    OK(lsdc_scene_free(other));

    // Millimetres in 16 bits and metres in floats.
    static uint16_t millimetres[PIXELS];
    for (int i = 0; i < PIXELS; ++i) millimetres[i] = (uint16_t)(1000.0f * sparse[i]);
    lsdc_map metres = map_of(sparse, WIDTH, HEIGHT), integers = map_of(NULL, WIDTH, HEIGHT);
    integers.data = millimetres;
    integers.size = sizeof millimetres;
    integers.format = LSDC_U16;
    integers.unit = 0.001;
    OK(lsdc_scene_complete_map(scene, &metres, NULL, NULL, &made));
    OK(lsdc_completion_depth(made, WIDTH, HEIGHT, expected, sizeof expected, 0));
    OK(lsdc_completion_free(made));
    OK(lsdc_scene_complete_map(scene, &integers, NULL, NULL, &made));
    OK(lsdc_completion_depth(made, WIDTH, HEIGHT, dense, sizeof dense, 0));
    CHECK(memcmp(dense, expected, sizeof dense) == 0);
    OK(lsdc_completion_free(made));

    // Holes marked by the largest number are not depths.
    size_t marked = 0;
    for (int i = 0; i < PIXELS; ++i) {
        if (millimetres[i] == 0 && i % 3 == 0) {
            millimetres[i] = 65535;
            ++marked;
        }
    }
    lsdc_report report;
    report.struct_size = sizeof report;
    OK(lsdc_scene_complete_map(scene, &integers, NULL, NULL, &made));
    OK(lsdc_completion_depth(made, WIDTH, HEIGHT, dense, sizeof dense, 0));
    CHECK(memcmp(dense, expected, sizeof dense) == 0);
    OK(lsdc_completion_report(made, &report));
    CHECK(marked > 0 && report.invalid == marked);
    CHECK(report.median_share >= 0.0 && report.median_share <= 1.0);
    // Without the weights `anything`, nothing sees sky.
    CHECK(report.sky_pixels == 0);
    OK(lsdc_completion_free(made));
}

static void alignment(void) {
    // Points away from the border of an image larger than the fixture's, so that shifted points stay inside.
    enum { W = 8 * WIDTH, H = 8 * HEIGHT, COUNT = 300 };
    static uint8_t colours[3 * W * H];
    static double x[COUNT], y[COUNT];
    static float z[COUNT];
    uint64_t random = 3;
    paint(colours, W, H, 7);
    for (int i = 0; i < COUNT; ++i) {
        x[i] = 40 + uniform(&random) * (W - 80);
        y[i] = 40 + uniform(&random) * (H - 80);
        z[i] = x[i] < W / 2.0 ? 2.0f : 3.0f;
    }
    lsdc_image image = image_of(colours, W, H);
    lsdc_points some = points_of(x, y, z, COUNT), few = points_of(x, y, z, 99);
    lsdc_scene *wide;
    lsdc_alignment *one, *both, *none;
    lsdc_shift shift;
    OK(lsdc_scene_create(completer, &image, NULL, &wide));
    FAILS(LSDC_ERROR_ARGUMENT, "`alignment` is null", lsdc_scene_alignment(wide, &some, NULL, NULL));
    FAILS(LSDC_ERROR_ARGUMENT, "null", lsdc_scene_alignment(wide, NULL, NULL, &one));
    CHECK(one == NULL);
    OK(lsdc_scene_alignment(wide, &some, NULL, &one));
    OK(lsdc_scene_alignment(wide, &some, one, &both));
    OK(lsdc_scene_alignment(wide, &few, NULL, &none));
    FAILS(LSDC_ERROR_ARGUMENT, "`shift` is null", lsdc_alignment_shift(one, NULL));
    shift.struct_size = sizeof shift;
    OK(lsdc_alignment_shift(one, &shift));
    CHECK(shift.frames == 1 && shift.points > 250 && isfinite(shift.x) && shift.error > 0 && shift.is_clear <= 1);
    const double moved = shift.x;
    OK(lsdc_alignment_shift(both, &shift));
    CHECK(shift.frames == 2 && shift.points > 500 && shift.x == moved);
    OK(lsdc_alignment_shift(none, &shift));
    OK(lsdc_alignment_free(none));
    CHECK(shift.frames == 0 && shift.points == 0 && isnan(shift.x) && shift.is_clear == 0);
    OK(lsdc_alignment_free(one));
    FAILS(LSDC_ERROR_HANDLE, "alignment", lsdc_scene_alignment(wide, &some, one, &none));
    CHECK(none == NULL);
    FAILS(LSDC_ERROR_HANDLE, "alignment", lsdc_alignment_free(one));
    OK(lsdc_alignment_free(both));
    OK(lsdc_alignment_free(NULL));
    OK(lsdc_scene_free(wide));
}

// A network run by another program: its input, and two levels of depth, fitted exactly.
static void network_output(void) {
    size_t width, height;
    lsdc_completer_options options = quick();
    options.working_width = WIDTH;
    options.working_height = HEIGHT;
    options.fit = LSDC_FIT_LSE;
    lsdc_completer *none;
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    static float input[3 * PIXELS], levels[PIXELS], pairs[2 * PIXELS];
    OK(lsdc_completer_create("none", &options, &none));
    OK(lsdc_completer_network_size(none, WIDTH, HEIGHT, &width, &height));
    CHECK(width == WIDTH && height == HEIGHT);
    OK(lsdc_completer_network_input(none, &image, input, sizeof input));
    for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < PIXELS; ++i) CHECK(fabsf(255.0f * input[c * PIXELS + i] - (float)rgb[3 * i + c]) < 1e-3f);
    }

    for (int i = 0; i < PIXELS; ++i) levels[i] = i % WIDTH < WIDTH / 2 ? 1.0f : 1.5f;
    for (int i = 0; i < 2 * PIXELS; ++i) pairs[i] = 1.0f;
    lsdc_network_output output;
    memset(&output, 0, sizeof output);
    output.struct_size = sizeof output;
    output.basis = levels;
    output.affinities = pairs;
    output.functions = 1;
    output.width = WIDTH;
    output.height = HEIGHT;
    lsdc_scene_options settings;
    memset(&settings, 0, sizeof settings);
    settings.struct_size = sizeof settings;
    settings.output = &output;
    // At pixel centres, 2 m on the left and 3 m on the right: twice the function.
    lsdc_map map = map_of(sparse, WIDTH, HEIGHT);
    lsdc_scene *other;
    lsdc_completion *made;
    OK(lsdc_scene_create(none, &image, &settings, &other));
    OK(lsdc_scene_complete_map(other, &map, NULL, NULL, &made));
    OK(lsdc_completion_depth(made, WIDTH, HEIGHT, dense, sizeof dense, 0));
    for (int i = 0; i < PIXELS; ++i) CHECK(fabsf(dense[i] - 2.0f * levels[i]) < 1e-4f);
    OK(lsdc_completion_free(made));
    OK(lsdc_scene_free(other));
    OK(lsdc_completer_free(none));
}

int main(void) {
    prepare();
    alignment();
    maps_and_points();
    outliers();
    layouts();
    network_output();
    release();
    puts("results: as they should be");
    return EXIT_SUCCESS;
}
