# One `warnings` target for our own code, and sanitizers or coverage for everything we compile.

add_library(brickyard_warnings INTERFACE)
add_library(brickyard::warnings ALIAS brickyard_warnings)
target_compile_options(brickyard_warnings INTERFACE -Wall -Wextra -Wshadow -Wconversion -Wnon-virtual-dtor
                                                    -Woverloaded-virtual -Wcast-align)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    # GCC 12 reports std::string + std::string at -O2 (PR 105651), and coroutine frames, wrongly.
    target_compile_options(brickyard_warnings INTERFACE -Wno-restrict -Wno-sign-conversion)
else()
    target_compile_options(brickyard_warnings INTERFACE -Wno-sign-conversion)
endif()
if(BRICKYARD_WARNINGS_AS_ERRORS)
    target_compile_options(brickyard_warnings INTERFACE -Werror)
endif()

# The picture must not depend on where the compiler fuses a multiply and an add.
add_compile_options(-ffp-contract=off)

if(BRICKYARD_SANITIZE)
    add_compile_options(-fsanitize=${BRICKYARD_SANITIZE} -fno-omit-frame-pointer)
    add_link_options(-fsanitize=${BRICKYARD_SANITIZE})
    if(BRICKYARD_SANITIZE MATCHES "undefined")
        add_compile_options(-fno-sanitize-recover=undefined)
    endif()
endif()
if(BRICKYARD_COVERAGE)
    add_compile_options(-fprofile-instr-generate -fcoverage-mapping)
    add_link_options(-fprofile-instr-generate)
endif()
