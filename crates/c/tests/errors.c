// All errors of functions that create handles, and structures of older and newer versions.
//
//     errors FOLDER      in which it may write

// setenv
#define _POSIX_C_SOURCE 200112L

#include "fixture.h"

static void versions(void) {
    CHECK(lsdc_abi_version() == LSDC_ABI_VERSION);
    CHECK(strchr(lsdc_version(), '.') != NULL);
    CHECK(strcmp(lsdc_last_error(), "") == 0 && strcmp(lsdc_last_hint(), "") == 0);
}

static void completers(const char *folder) {
    lsdc_completer *made = completer;
    lsdc_completer_options options = quick();
    FAILS(LSDC_ERROR_ARGUMENT, "`completer` is null", lsdc_completer_create("small", &options, NULL));
    FAILS(LSDC_ERROR_ARGUMENT, "`weights` is null", lsdc_completer_create(NULL, &options, &made));
    CHECK(made == NULL);
    FAILS(LSDC_ERROR_WEIGHTS, "no weights named `huge`", lsdc_completer_create("huge", &options, &made));
    CHECK(strstr(lsdc_last_hint(), "\"default\"") != NULL);
    // The encoder of these weights is installed separately.
    setenv("LSDC_WEIGHTS", "nowhere", 1);
    FAILS(LSDC_ERROR_WEIGHTS, "the encoder of Depth Anything V2 Small (ViT-S/14), which is not in `nowhere`",
          lsdc_completer_create("anything", &options, &made));
    CHECK(strstr(lsdc_last_hint(), "lsdc weights get anything") != NULL);
    CHECK(strstr(lsdc_last_hint(), "lsdc weights add FILE") != NULL);
    unsetenv("LSDC_WEIGHTS");
    FAILS(LSDC_ERROR_ARGUMENT, "not UTF-8", lsdc_completer_create("\xff\xfe", &options, &made));

    options.fit = 4;
    FAILS(LSDC_ERROR_ARGUMENT, "`options->fit` 4", lsdc_completer_create("small", &options, &made));
    options = quick();
    options.robust = UINT32_MAX;
    FAILS(LSDC_ERROR_ARGUMENT, "`options->robust`", lsdc_completer_create("small", &options, &made));
    options = quick();
    options.threads = 5000;
    FAILS(LSDC_ERROR_SETTINGS, "4096 threads", lsdc_completer_create("small", &options, &made));
    options.threads = SIZE_MAX;
    FAILS(LSDC_ERROR_SETTINGS, "4096 threads", lsdc_completer_create("small", &options, &made));
    options = quick();
    options.working_width = 0;
    CHECK(lsdc_completer_create("small", &options, &made) != LSDC_OK && made == NULL);
    options.working_width = options.working_height = SIZE_MAX;
    CHECK(lsdc_completer_create("small", &options, &made) != LSDC_OK && made == NULL);
    options = quick();
    options.encoder_side = 336;
    FAILS(LSDC_ERROR_SETTINGS, "no encoder", lsdc_completer_create("small", &options, &made));
    options.encoder_side = 600;
    FAILS(LSDC_ERROR_SETTINGS, "not 252 to 518", lsdc_completer_create("small", &options, &made));
    options = quick();

    FAILS(LSDC_ERROR_ARGUMENT, "`path` is null", lsdc_completer_create_from_file(NULL, &options, &made));
    FAILS(LSDC_ERROR_WEIGHTS, "cannot read weights", lsdc_completer_create_from_file("", &options, &made));
    FAILS(LSDC_ERROR_WEIGHTS, folder, lsdc_completer_create_from_file(folder, &options, &made));
    char path[4096];
    snprintf(path, sizeof path, "%s/not-weights", folder);
    FILE *file = fopen(path, "wb");
    CHECK(file != NULL && fwrite(rgb, 1, sizeof rgb, file) == sizeof rgb && fclose(file) == 0);
    FAILS(LSDC_ERROR_WEIGHTS, "safetensors", lsdc_completer_create_from_file(path, &options, &made));
    CHECK(*lsdc_last_hint() != '\0');

    FAILS(LSDC_ERROR_ARGUMENT, "`data` is null", lsdc_completer_create_from_memory(NULL, 9, &options, &made));
    FAILS(LSDC_ERROR_WEIGHTS, "safetensors", lsdc_completer_create_from_memory(NULL, 0, &options, &made));
    FAILS(LSDC_ERROR_WEIGHTS, "safetensors", lsdc_completer_create_from_memory(rgb, 99, &options, &made));
    FAILS(LSDC_ERROR_BUFFER, "exceed all memory",
          lsdc_completer_create_from_memory(rgb, SIZE_MAX, &options, &made));
    CHECK(made == NULL);
}

// The structure of a program compiled with a newer header.
struct newer_options {
    lsdc_completer_options known;
    uint64_t unknown;
};
struct older_report {
    size_t struct_size, given, used;
    size_t untouched;
};
struct newer_report {
    lsdc_report known;
    uint64_t unknown;
};

static void sizes_of_structures(void) {
    lsdc_completer *made;
    lsdc_completer_options options = quick();
    const size_t impossible[] = {0, 1, sizeof(size_t) - 1, sizeof options - 1, 8192, SIZE_MAX};
    for (size_t i = 0; i < sizeof impossible / sizeof *impossible; ++i) {
        options.struct_size = impossible[i];
        FAILS(LSDC_ERROR_ARGUMENT, "struct_size", lsdc_completer_create("small", &options, &made));
        CHECK(strstr(lsdc_last_hint(), "sizeof") != NULL);
    }
    // An older structure: the invalid values after its end are not read.
    options = quick();
    options.fit = options.robust = 77;
    options.struct_size = offsetof(lsdc_completer_options, fit);
    OK(lsdc_completer_create("small", &options, &made));
    OK(lsdc_completer_free(made));

    struct newer_options newer;
    newer.known = quick();
    newer.known.struct_size = sizeof newer;
    newer.unknown = 0;
    OK(lsdc_completer_create("small", &newer.known, &made));
    OK(lsdc_completer_free(made));
    newer.unknown = 1;
    FAILS(LSDC_ERROR_ARGUMENT, "does not know", lsdc_completer_create("small", &newer.known, &made));

    lsdc_report report;
    report.struct_size = sizeof report;
    OK(lsdc_completion_report(completion, &report));
    CHECK(report.struct_size == sizeof report && report.given == 100 && report.used == 100);
    CHECK(report.fit == LSDC_FIT_JOINT && isnan(report.guide_trust) && report.highest > 29.9);
    struct older_report older = {offsetof(struct older_report, untouched), 0, 0, 55};
    OK(lsdc_completion_report(completion, (lsdc_report *)&older));
    CHECK(older.given == 100 && older.used == 100 && older.untouched == 55);
    struct newer_report later;
    later.known.struct_size = sizeof later;
    later.unknown = 66;
    OK(lsdc_completion_report(completion, &later.known));
    CHECK(later.known.residual == report.residual && later.unknown == 0);
    report.struct_size = 12;
    FAILS(LSDC_ERROR_ARGUMENT, "`report->struct_size` is 12", lsdc_completion_report(completion, &report));
    FAILS(LSDC_ERROR_ARGUMENT, "`report` is null", lsdc_completion_report(completion, NULL));
}

static void handles(void) {
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    lsdc_points points = points_of(xs, ys, depths, 100);
    lsdc_scene *none;
    lsdc_completion *nothing;
    size_t width, height;
    int local = 0;
    FAILS(LSDC_ERROR_ARGUMENT, "`completer` is null", lsdc_scene_create(NULL, &image, NULL, &none));
    FAILS(LSDC_ERROR_HANDLE, "this completer was freed",
          lsdc_scene_create((lsdc_completer *)(void *)&local, &image, NULL, &none));
    FAILS(LSDC_ERROR_HANDLE, "this completer was freed",
          lsdc_scene_create((lsdc_completer *)(void *)scene, &image, NULL, &none));
    CHECK(none == NULL);
    FAILS(LSDC_ERROR_HANDLE, "this scene",
          lsdc_scene_complete((lsdc_scene *)(uintptr_t)1, &points, NULL, &nothing));
    CHECK(nothing == NULL);
    FAILS(LSDC_ERROR_ARGUMENT, "`scene` is null", lsdc_scene_size(NULL, &width, &height));
    FAILS(LSDC_ERROR_ARGUMENT, "`width` is null", lsdc_scene_size(scene, NULL, &height));
    width = 5;
    FAILS(LSDC_ERROR_ARGUMENT, "`height` is null", lsdc_scene_size(scene, &width, NULL));
    CHECK(width == 5);
    OK(lsdc_scene_size(scene, &width, &height));
    CHECK(width == WIDTH && height == HEIGHT);

    OK(lsdc_scene_create(completer, &image, NULL, &none));
    OK(lsdc_scene_free(none));
    FAILS(LSDC_ERROR_HANDLE, "this scene was freed", lsdc_scene_free(none));
    FAILS(LSDC_ERROR_HANDLE, "this scene", lsdc_scene_complete(none, &points, NULL, &nothing));
    FAILS(LSDC_ERROR_HANDLE, "this completion", lsdc_completion_free((lsdc_completion *)(void *)scene));
    OK(lsdc_completer_release(completer));
    FAILS(LSDC_ERROR_ARGUMENT, "`completer` is null", lsdc_completer_release(NULL));
    FAILS(LSDC_ERROR_HANDLE, "this completer", lsdc_completer_release((lsdc_completer *)(void *)scene));
    OK(lsdc_scene_free(NULL));
    OK(lsdc_completer_free(NULL));
    OK(lsdc_completion_free(NULL));

    // Objects created with a handle outlive it.
    lsdc_completer_options options = quick();
    lsdc_completer *short_lived;
    OK(lsdc_completer_create("small", &options, &short_lived));
    OK(lsdc_scene_create(short_lived, &image, NULL, &none));
    OK(lsdc_completer_free(short_lived));
    FAILS(LSDC_ERROR_HANDLE, "this completer", lsdc_completer_free(short_lived));
    OK(lsdc_scene_complete(none, &points, NULL, &nothing));
    OK(lsdc_scene_free(none));
    OK(lsdc_completion_depth(nothing, WIDTH, HEIGHT, dense, sizeof dense, 0));
    OK(lsdc_completion_free(nothing));
    FAILS(LSDC_ERROR_HANDLE, "this completion",
          lsdc_completion_depth(nothing, WIDTH, HEIGHT, dense, sizeof dense, 0));
}

static void expect_image(lsdc_status status, const char *text, const lsdc_image *image) {
    lsdc_scene *none = scene;
    FAILS(status, text, lsdc_scene_create(completer, image, NULL, &none));
    CHECK(none == NULL);
}

static void images(void) {
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    FAILS(LSDC_ERROR_ARGUMENT, "`scene` is null", lsdc_scene_create(completer, &image, NULL, NULL));
    expect_image(LSDC_ERROR_ARGUMENT, "`image` is null", NULL);
    image.struct_size = sizeof image - sizeof(size_t);
    expect_image(LSDC_ERROR_ARGUMENT, "struct_size", &image);
    image = image_of(NULL, WIDTH, HEIGHT);
    expect_image(LSDC_ERROR_ARGUMENT, "`image->data` is null", &image);
    image = image_of(rgb, WIDTH, HEIGHT);
    image.format = 99;
    expect_image(LSDC_ERROR_ARGUMENT, "`image->format` 99", &image);
    image = image_of(rgb, WIDTH, HEIGHT);
    image.reserved = 1;
    expect_image(LSDC_ERROR_ARGUMENT, "reserved", &image);

    image = image_of(rgb, WIDTH, HEIGHT);
    image.size -= 1;
    expect_image(LSDC_ERROR_BUFFER, "4608 bytes, but its buffer has 4607", &image);
    // Colours taken for grey values.
    image = image_of(rgb, WIDTH, HEIGHT);
    image.format = LSDC_GREY8;
    expect_image(LSDC_ERROR_BUFFER, "1536 bytes, but its buffer has 4608", &image);
    image = image_of(rgb, WIDTH, HEIGHT);
    image.stride = 3 * WIDTH - 1;
    expect_image(LSDC_ERROR_BUFFER, "overlap", &image);
    image.stride = SIZE_MAX;
    expect_image(LSDC_ERROR_BUFFER, "exceed all memory", &image);
    const size_t sides[][2] = {{0, 1}, {1, 0}, {SIZE_MAX, SIZE_MAX}, {SIZE_MAX, 2}, {(size_t)1 << 31, 1}};
    for (size_t i = 0; i < sizeof sides / sizeof *sides; ++i) {
        image = image_of(rgb, WIDTH, HEIGHT);
        image.width = sides[i][0];
        image.height = sides[i][1];
        expect_image(LSDC_ERROR_BUFFER, "cannot have", &image);
    }

    float colours[2 * 3] = {0.1f, 0.2f, 0.3f, NAN, 0.5f, 0.6f};
    image = image_of(colours, 2, 1);
    image.format = LSDC_RGB_F32;
    image.size = sizeof colours;
    expect_image(LSDC_ERROR_IMAGE, "column 1, row 0 is not finite", &image);
    colours[3] = 255.0f;
    expect_image(LSDC_ERROR_IMAGE, "1 is white", &image);
}

static void guides(void) {
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    lsdc_map guide = map_of(dense, WIDTH, HEIGHT);
    lsdc_scene_options options;
    lsdc_scene *made;
    memset(&options, 0, sizeof options);
    options.struct_size = sizeof options;
    options.guide = &guide;
    for (int i = 0; i < PIXELS; ++i) dense[i] = 1.0f + (float)(i % WIDTH);

    options.guide_kind = 3;
    FAILS(LSDC_ERROR_ARGUMENT, "guide_kind", lsdc_scene_create(completer, &image, &options, &made));
    options.guide_kind = LSDC_GUIDE_DEPTH;
    options.reserved = 9;
    FAILS(LSDC_ERROR_ARGUMENT, "reserved", lsdc_scene_create(completer, &image, &options, &made));
    options.reserved = 0;
    guide.size = 1;
    FAILS(LSDC_ERROR_BUFFER, "`options->guide`", lsdc_scene_create(completer, &image, &options, &made));
    guide = map_of(dense, WIDTH, HEIGHT);
    OK(lsdc_scene_create(completer, &image, &options, &made));
    lsdc_points points = points_of(xs, ys, depths, 100);
    lsdc_completion *guided;
    lsdc_report report;
    report.struct_size = sizeof report;
    OK(lsdc_scene_complete(made, &points, NULL, &guided));
    OK(lsdc_completion_report(guided, &report));
    CHECK(report.guide_trust >= 0.0);
    OK(lsdc_completion_free(guided));
    OK(lsdc_scene_free(made));
    // A completer without a network needs a guide.
    lsdc_completer_options settings = quick();
    lsdc_completer *alone;
    OK(lsdc_completer_create("none", &settings, &alone));
    OK(lsdc_scene_create(alone, &image, &options, &made));
    OK(lsdc_scene_complete(made, &points, NULL, &guided));
    OK(lsdc_completion_free(guided));
    OK(lsdc_scene_free(made));
    OK(lsdc_completer_free(alone));
    for (int i = 0; i < PIXELS; ++i) dense[i] = NAN;
    FAILS(LSDC_ERROR_IMAGE, "the guide says nothing", lsdc_scene_create(completer, &image, &options, &made));
    CHECK(made == NULL);
}

static void outputs(void) {
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    size_t width = 5, height = 6;
    FAILS(LSDC_ERROR_ARGUMENT, "`completer` is null", lsdc_completer_network_size(NULL, 4, 3, &width, &height));
    FAILS(LSDC_ERROR_ARGUMENT, "`width` is null", lsdc_completer_network_size(completer, 4, 3, NULL, &height));
    FAILS(LSDC_ERROR_ARGUMENT, "`height` is null", lsdc_completer_network_size(completer, 4, 3, &width, NULL));
    FAILS(LSDC_ERROR_BUFFER, "cannot have 0x3", lsdc_completer_network_size(completer, 0, 3, &width, &height));
    FAILS(LSDC_ERROR_BUFFER, "cannot have", lsdc_completer_network_size(completer, SIZE_MAX, 3, &width, &height));
    CHECK(width == 5 && height == 6);
    OK(lsdc_completer_network_size(completer, WIDTH, HEIGHT, &width, &height));
    CHECK(width > 1 && height > 1 && width * height <= PIXELS);

    dense[0] = -5.0f;
    const size_t bytes = 3 * width * height * sizeof(float);
    FAILS(LSDC_ERROR_ARGUMENT, "`image` is null", lsdc_completer_network_input(completer, NULL, dense, bytes));
    FAILS(LSDC_ERROR_ARGUMENT, "`values` is null", lsdc_completer_network_input(completer, &image, NULL, bytes));
    FAILS(LSDC_ERROR_BUFFER, "its buffer has", lsdc_completer_network_input(completer, &image, dense, bytes - 1));
    CHECK(dense[0] == -5.0f);

    // 65 functions of 4x3 pixels.
    static float basis[65 * 12], affinities[2 * 12];
    for (int i = 0; i < 65 * 12; ++i) basis[i] = i < 12 ? 1.0f : (float)(i % 7);
    lsdc_network_output output, sound;
    memset(&sound, 0, sizeof sound);
    sound.struct_size = sizeof sound;
    sound.basis = basis;
    sound.affinities = affinities;
    sound.functions = 65;
    sound.width = 4;
    sound.height = 3;
    lsdc_scene_options options;
    memset(&options, 0, sizeof options);
    options.struct_size = sizeof options;
    options.output = &output;
    lsdc_scene *made = scene;
    output = sound;
    output.struct_size = 8;
    FAILS(LSDC_ERROR_ARGUMENT, "struct_size", lsdc_scene_create(completer, &image, &options, &made));
    output = sound;
    output.basis = NULL;
    FAILS(LSDC_ERROR_ARGUMENT, "`options->output->basis` is null", lsdc_scene_create(completer, &image, &options, &made));
    output = sound;
    output.affinities = NULL;
    FAILS(LSDC_ERROR_ARGUMENT, "`options->output->affinities` is null",
          lsdc_scene_create(completer, &image, &options, &made));
    output = sound;
    output.width = 0;
    FAILS(LSDC_ERROR_BUFFER, "cannot have 0x3", lsdc_scene_create(completer, &image, &options, &made));
    output.width = SIZE_MAX;
    FAILS(LSDC_ERROR_BUFFER, "cannot have", lsdc_scene_create(completer, &image, &options, &made));
    output = sound;
    output.functions = SIZE_MAX / 2;
    FAILS(LSDC_ERROR_BUFFER, "exceed all memory", lsdc_scene_create(completer, &image, &options, &made));
    output.functions = 64;
    FAILS(LSDC_ERROR_FIT, "64 basis functions", lsdc_scene_create(completer, &image, &options, &made));
    output.functions = 0;
    FAILS(LSDC_ERROR_FIT, "0 values", lsdc_scene_create(completer, &image, &options, &made));
    output = sound;
    affinities[5] = -1.0f;
    CHECK(lsdc_scene_create(completer, &image, &options, &made) == LSDC_ERROR_FIT && made == NULL);
    affinities[5] = NAN;
    CHECK(lsdc_scene_create(completer, &image, &options, &made) == LSDC_ERROR_FIT && made == NULL);
    affinities[5] = 1.0f;
    OK(lsdc_scene_create(completer, &image, &options, &made));
    OK(lsdc_scene_free(made));
}

static void expect_points(lsdc_status status, const char *text, const lsdc_points *points) {
    lsdc_completion *none = completion;
    FAILS(status, text, lsdc_scene_complete(scene, points, NULL, &none));
    CHECK(none == NULL);
}

static void points(void) {
    lsdc_points some = points_of(xs, ys, depths, 100);
    FAILS(LSDC_ERROR_ARGUMENT, "`completion` is null", lsdc_scene_complete(scene, &some, NULL, NULL));
    expect_points(LSDC_ERROR_ARGUMENT, "`points` is null", NULL);
    some = points_of(NULL, ys, depths, 100);
    expect_points(LSDC_ERROR_ARGUMENT, "`points->x` is null", &some);
    some = points_of(xs, NULL, depths, 100);
    expect_points(LSDC_ERROR_ARGUMENT, "`points->y` is null", &some);
    some = points_of(xs, ys, NULL, 100);
    expect_points(LSDC_ERROR_ARGUMENT, "`points->depth` is null", &some);
    some = points_of(NULL, NULL, NULL, 0);
    expect_points(LSDC_ERROR_FIT, "there is no sparse depth", &some);
    CHECK(*lsdc_last_hint() != '\0');
    some = points_of(xs, ys, depths, SIZE_MAX);
    expect_points(LSDC_ERROR_BUFFER, "more than", &some);
    some = points_of(xs, ys, depths, 50);
    some.stride = 4;
    expect_points(LSDC_ERROR_BUFFER, "overlap", &some);
    some.stride = SIZE_MAX / 2;
    expect_points(LSDC_ERROR_BUFFER, "exceed all memory", &some);

    const float bad[] = {NAN, INFINITY, -1.0f, 0.0f, 1e30f};
    some = points_of(xs, ys, bad, 5);
    expect_points(LSDC_ERROR_FIT, "of 5 observations 5 have no depth", &some);
    const double outside[] = {-0.6, WIDTH - 0.5, 1e300, -1e300, WIDTH};
    some = points_of(outside, ys, depths, 5);
    expect_points(LSDC_ERROR_FIT, "5 are outside", &some);
    const double unknown[] = {NAN, INFINITY, NAN, NAN, NAN};
    some = points_of(unknown, ys, depths, 5);
    expect_points(LSDC_ERROR_FIT, "5 have no depth", &some);

    // Points that are left out are counted, and have NaN as results.
    const float mixed[] = {2.0f, NAN, 2.5f, 3.0f, 2.0f, 2.2f, 2.4f};
    const double across[] = {5.0, 6.0, -9.0, 30.0, 8.0, 20.0, 40.0}, down[] = {5.0, 6.0, 7.0, 8.0, 30.0, 20.0, 25.0};
    // Standard deviations that are not positive and finite are unknown.
    const float known[] = {0.1f, 0.1f, 0.1f, 0.0f, -0.1f, NAN, INFINITY};
    double residuals[7];
    some = points_of(across, down, mixed, 7);
    some.sigma = known;
    lsdc_completion *few;
    lsdc_report report;
    report.struct_size = sizeof report;
    OK(lsdc_scene_complete(scene, &some, NULL, &few));
    OK(lsdc_completion_report(few, &report));
    CHECK(report.given == 7 && report.used == 5 && report.invalid == 1 && report.outside == 1);
    CHECK(report.without_deviation == 4);
    OK(lsdc_completion_residuals(few, residuals, 7));
    CHECK(isfinite(residuals[0]) && isnan(residuals[1]) && isnan(residuals[2]) && isfinite(residuals[3]));
    OK(lsdc_completion_free(few));

    // The only point has no leave-one-out error.
    double error;
    some = points_of(across, down, mixed, 1);
    OK(lsdc_scene_complete(scene, &some, NULL, &few));
    OK(lsdc_completion_leave_one_out_error(few, &error));
    CHECK(isnan(error));
    OK(lsdc_completion_free(few));
}

static void expect_map(lsdc_status status, const char *text, const lsdc_map *depth, const lsdc_map *sigma) {
    lsdc_completion *none = completion;
    FAILS(status, text, lsdc_scene_complete_map(scene, depth, sigma, NULL, &none));
    CHECK(none == NULL);
}

static void maps(void) {
    lsdc_map map = map_of(sparse, WIDTH, HEIGHT), other;
    expect_map(LSDC_ERROR_ARGUMENT, "`depth` is null", NULL, NULL);
    map.struct_size = 8;
    expect_map(LSDC_ERROR_ARGUMENT, "`depth->struct_size`", &map, NULL);
    map = map_of(NULL, WIDTH, HEIGHT);
    expect_map(LSDC_ERROR_ARGUMENT, "`depth->data` is null", &map, NULL);
    map = map_of(sparse, WIDTH, HEIGHT);
    map.format = 2;
    expect_map(LSDC_ERROR_ARGUMENT, "`depth->format` 2", &map, NULL);
    map = map_of(sparse, WIDTH, HEIGHT);
    map.format = LSDC_U16;
    map.size /= 2;
    expect_map(LSDC_ERROR_ARGUMENT, "`depth->unit` is 0", &map, NULL);
    const double units[] = {-1.0, NAN, INFINITY};
    for (size_t i = 0; i < 3; ++i) {
        map = map_of(sparse, WIDTH, HEIGHT);
        map.unit = units[i];
        expect_map(LSDC_ERROR_ARGUMENT, "`depth->unit`", &map, NULL);
    }
    map = map_of(sparse, HEIGHT, WIDTH);
    expect_map(LSDC_ERROR_BUFFER, "32x48 pixels, but the image 48x32", &map, NULL);
    map = map_of(sparse, WIDTH, HEIGHT);
    map.size += 4;
    expect_map(LSDC_ERROR_BUFFER, "bytes", &map, NULL);
    map = map_of(sparse, WIDTH, HEIGHT);
    other = map_of(sparse, WIDTH, HEIGHT - 1);
    expect_map(LSDC_ERROR_BUFFER, "the map of sigmas has 48x31", &map, &other);
    other = map_of(NULL, WIDTH, HEIGHT);
    expect_map(LSDC_ERROR_ARGUMENT, "`sigma->data` is null", &map, &other);
    memset(dense, 0, sizeof dense);
    map = map_of(dense, WIDTH, HEIGHT);
    expect_map(LSDC_ERROR_FIT, "there is no sparse depth", &map, NULL);

    // NaN and negative values are no measurements, and are reported.
    memcpy(dense, sparse, sizeof dense);
    dense[1] = NAN;
    dense[2] = -1.0f;
    lsdc_completion *made;
    lsdc_report report;
    report.struct_size = sizeof report;
    OK(lsdc_scene_complete_map(scene, &map, NULL, NULL, &made));
    OK(lsdc_completion_report(made, &report));
    CHECK(report.invalid == 2 && report.used + 2 == report.given);
    OK(lsdc_completion_free(made));
}

static void previous_frames(void) {
    lsdc_points some = points_of(xs, ys, depths, 100);
    lsdc_complete_options options;
    lsdc_completion *next;
    options.struct_size = sizeof options;
    options.previous = completion;
    OK(lsdc_scene_complete(scene, &some, &options, &next));
    OK(lsdc_completion_free(next));
    options.previous = next;
    FAILS(LSDC_ERROR_HANDLE, "this completion", lsdc_scene_complete(scene, &some, &options, &next));
    options.struct_size = 3;
    FAILS(LSDC_ERROR_ARGUMENT, "`options->struct_size` is 3", lsdc_scene_complete(scene, &some, &options, &next));

    // A field alone has no weights that a previous completion could regularise.
    lsdc_completer_options field = quick();
    field.fit = LSDC_FIT_FIELD;
    lsdc_completer *other;
    lsdc_scene *alone;
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    OK(lsdc_completer_create("small", &field, &other));
    OK(lsdc_scene_create(other, &image, NULL, &alone));
    options.struct_size = sizeof options;
    options.previous = completion;
    FAILS(LSDC_ERROR_FIT, "learned prior", lsdc_scene_complete(alone, &some, &options, &next));
    CHECK(next == NULL && strstr(lsdc_last_hint(), "LSDC_FIT_JOINT") != NULL);
    OK(lsdc_scene_free(alone));
    OK(lsdc_completer_free(other));
}

int main(int count, char **arguments) {
    CHECK(count == 2);
    versions();
    prepare();
    completers(arguments[1]);
    sizes_of_structures();
    handles();
    images();
    guides();
    outputs();
    points();
    maps();
    previous_frames();
    release();
    puts("errors: as they should be");
    return EXIT_SUCCESS;
}
